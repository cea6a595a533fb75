"""What is measured on a tissue, whether finite elements or the simulator compute it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from carecontact.errors import CarecontactError
from carecontact.validation.fem.cases import DEPTHS_M, RING_M, RINGS_M, TOUCH_N, Case
from carecontact.validation.result import Array


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Presses with one tool, each from before touch on: one for finite elements, one for each place of a person."""

    presses: tuple[tuple[Array, Array], ...]
    """For each press, increasing travel past geometric touch (n,) [m] and force (n,) [N]."""

    def at(self, depths_m: Array, *, touch_n: float = TOUCH_N) -> Array:
        """Return the mean force (k,) [N] at depths past each press's own touch, where its force first exceeds
        ``touch_n``.
        """
        return np.mean(
            [np.interp(depths_m, d - touch_m(d, force, touch_n), force) for d, force in self.presses], axis=0
        )

    def touch_m(self, touch_n: float = TOUCH_N) -> float:
        """Return the mean travel [m] past geometric touch at which the force first exceeds ``touch_n``."""
        return float(np.mean([touch_m(travel, force, touch_n) for travel, force in self.presses]))


@dataclass(frozen=True, kw_only=True)
class Drag:
    """A tool that was pressed in to the deepest of DEPTHS_M past touch and then moved along at that depth."""

    way_m: Array
    """(n,) distance along, from 0 on"""
    force_n: Array
    """(n,) force against the motion, with friction"""
    normal_n: Array
    """(n,) force along the press"""
    stuck_n_m: float
    """Initial ratio of force to distance if tool and surface are glued together."""
    contact_radius_m: float = float("nan")
    """Radius of a circle with the area of contact; not a number for the simulator."""

    def at(self, ways_m: ArrayLike) -> Array:
        """Return the force [N] against the motion at distances [m], in their shape."""
        return np.interp(np.asarray(ways_m, np.float64), self.way_m, self.force_n)


@dataclass(frozen=True, kw_only=True)
class Answer:
    """How one tissue responds to every tool of a case."""

    curves: Mapping[str, Curve]
    """By the tool's name."""
    dimple: Array
    """(k,) share of the main tool's travel by which the surface sank at RINGS_M"""
    beside: Array
    """(k,) the same, along the surface's own normal and around the limb alone: negative where it bulges"""
    drags: Mapping[str, Drag]
    """By the tool's name."""
    modulus_pa: float = float("nan")
    """Young's modulus of the tissue under the skin; not a number for the simulator, which has no modulus."""

    def exponents(self, case: Case, word: str) -> Array:
        """Return the exponent (d,) of force over radius at DEPTHS_M, from the RADII of the balls or discs."""
        tools = [tool for name, tool in case.tools().items() if name.startswith(word) and tool not in case.more]
        force = np.log([self.curves[tool.name].at(DEPTHS_M) for tool in tools])
        return np.polyfit(np.log([tool.radius_m for tool in tools]), force, 1)[0]

    def shares(self, case: Case, *, touch_n: float = TOUCH_N) -> Array:
        """Return the force (d,) of the reference's own indenter at DEPTHS_M, divided by that at the deepest of them."""
        force = self.curves[case.main.name].at(DEPTHS_M, touch_n=touch_n)
        return force / force[-1]

    def dimple_at(self, distances_m: Array) -> Array:
        """Return the share (k,) of the main tool's travel by which the surface sank at these distances [m]."""
        return np.interp(distances_m, RINGS_M, self.dimple)

    def beside_at(self, distances_m: Array) -> Array:
        """Return the share (k,) of ``beside`` at these distances [m]."""
        return np.interp(distances_m, RINGS_M, self.beside)


def touch_m(travel_m: Array, force_n: Array, threshold_n: float) -> float:
    """Return the interpolated travel [m] at which a press first exceeds the threshold. Raises CarecontactError if it
    never does.
    """
    over = np.flatnonzero(force_n > threshold_n)
    if not len(over):
        raise CarecontactError(f"a press never exceeds {threshold_n} N")
    k = max(int(over[0]), 1)
    return float(np.interp(threshold_n, force_n[k - 1 : k + 1], travel_m[k - 1 : k + 1]))


def rings(places_m: Array, sunk_m: Array, *, beside: bool = False) -> Array:
    """Return the mean (r,) over the points in each ring of RINGS_M; not a number for a ring without points.

    Args:
        places_m: (n, 2) across and along from the tool's axis.
        beside: whether only points at most RING_M along from the axis count.
    """
    distance_m, chosen = np.hypot(*places_m.T), (np.abs(places_m[:, 1]) <= RING_M) | (not beside)
    near = [chosen & (np.abs(distance_m - ring) <= RING_M) for ring in RINGS_M]
    return np.array([sunk_m[pick].mean() if pick.any() else np.nan for pick in near])
