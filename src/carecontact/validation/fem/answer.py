"""What is measured of a tissue, whether finite elements or the simulator answer for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from carecontact.sim.bench import touch_depth
from carecontact.validation.fem.cases import DEPTHS_M, TOUCH_N, Case
from carecontact.validation.result import Array


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Presses with one indenter, each from before touch on: one for finite elements, one for each place of a person."""

    presses: tuple[tuple[Array, Array], ...]
    """For each, (n,) travel past geometric touch [m], increasing, and (n,) force [N]."""

    def at(self, depths_m: Array, *, touch_n: float = TOUCH_N) -> Array:
        """(k,) mean force at depths past each press's own touch, where its force first exceeds ``touch_n``."""
        return np.mean(
            [np.interp(depths_m, d - touch_depth(d, force, touch_n), force) for d, force in self.presses], axis=0
        )


@dataclass(frozen=True, kw_only=True)
class Answer:
    """How one tissue answers every indenter of a case."""

    curves: Mapping[str, Curve]
    """By the indenter's name."""
    dimple_m: Array
    """(k,) how far the surface sank at ``dimple_at_m``, under the reference's indenter at its deepest"""
    dimple_at_m: Array
    """(k,) distance from the indenter's axis, increasing"""
    dimple_travel_m: float
    """Travel of the indenter past geometric touch there."""
    modulus_pa: float = float("nan")
    """Of the tissue under the skin; not a number for the simulator, which has no modulus."""

    def exponents(self, word: str) -> Array:
        """(d,) exponent of force over radius at DEPTHS_M, of all indenters whose name begins with ``word``."""
        names = [name for name in self.curves if name.startswith(word)]
        radius = np.log([float(name.split()[1]) for name in names])
        force = np.log([self.curves[name].at(DEPTHS_M) for name in names])
        return np.polyfit(radius, force, 1)[0]

    def shares(self, case: Case, *, touch_n: float = TOUCH_N) -> Array:
        """(d,) force at DEPTHS_M over the force at the deepest, of the reference's own indenter."""
        force = self.curves[case.main()].at(DEPTHS_M, touch_n=touch_n)
        return force / force[-1]

    def dimple(self, at_m: Array) -> Array:
        """(k,) share of the indenter's travel by which the surface sank at these distances."""
        return np.interp(at_m, self.dimple_at_m, self.dimple_m) / self.dimple_travel_m
