"""What is compared between finite elements and simulator: materials, ground, tools, places and depths, and what an
answer holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from carecontact.errors import CarecontactError
from carecontact.interface.robot import EMBODIMENTS
from carecontact.lab.validation.result import Array
from carecontact.lab.validation.rig import ABDOMEN, FOREARM, UPPER_ARM_ANTERIOR, UPPER_ARM_POSTERIOR, Reference

# The materials of the layer. Nothing here was fitted to the simulated tissue.
#
# Skin's modulus and thickness are published. The tissue under it (fat and muscle as one) has a modulus that is solved
# for, with each skin, so that the layer gives the mean force of published indentations of people at MATCHED_M: the one
# number that the finite elements take from the reference curve.

POISSON = 0.49
"""Assumption: nearly incompressible, as soft tissue is usually taken within seconds of loading."""
OTHER_POISSON = (0.45, 0.495)
"""Further values of Poisson's ratio, which are compared with POISSON for the middle skin."""
FRICTION = 0.5
"""Coefficient of friction between tool and skin: the middle of the reported values for dry skin on smooth materials,
about 0.2 to 0.8 (Derler and Gerhardt 2012, Tribol Lett 45:1), as in the tissue sets."""
OTHER_FRICTION = (0.25, 0.8)
"""Further values of friction, which are compared with FRICTION for the middle skin: cotton on forearm and chest (Temel
et al. 2022, second hand)."""
THICKNESS_M = (0.0008, 0.0015, 0.0022)
"""Least, middle and largest thickness of skin. The mean over people was 0.79 mm (foot) to 1.48 mm (chest) at 24 sites
(Krackowizer and Brenner 2008, Phlebologie 37:83, abstract) and 2.2 mm at arm and abdomen (Gibney et al. 2010, Curr Med
Res Opin 26:1519, abstract). The middle one is our choice."""
MODULUS_PA = (0.13e6, 0.42e6, 0.85e6)
"""Least, middle and largest modulus of skin: 0.129 MPa by suction on the volar forearm (Diridollou et al. 2000, Skin
Res Technol 6:214, abstract); 0.42 MPa in the young and 0.85 MPa in the old by torsion (Agache et al. 1980, Arch
Dermatol Res 269:221; the abstract says that the modulus doubles with age, and its figures come second hand). Published
values from indentation are lower, because they mix skin with what lies under it; the layer without skin represents
them."""
MATCHED_M = 0.004
"""Depth past touch at which layer and reference have the same force: near the end of the forearm's curve, and the
deepest at which the linear layer is used."""


@dataclass(frozen=True, kw_only=True)
class Skin:
    name: str
    thickness_m: float
    """Thickness of the skin; 0 means no skin."""
    modulus_pa: float


PLAIN = Skin(name="plain", thickness_m=0.0, modulus_pa=0.0)
MIDDLE = Skin(name="middle", thickness_m=THICKNESS_M[1], modulus_pa=MODULUS_PA[1])
CORNERS = tuple(
    Skin(name=f"{thin} {soft}", thickness_m=thickness, modulus_pa=modulus)
    for thin, thickness in (("thin", THICKNESS_M[0]), ("thick", THICKNESS_M[2]))
    for soft, modulus in (("soft", MODULUS_PA[0]), ("stiff", MODULUS_PA[2]))
)
SKINS = (MIDDLE, *CORNERS)
"""The skins of the published range: its middle and its corners."""


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Tissue bonded to rigid bone ``thickness_m`` under its surface; infinite along and, if flat, across."""

    thickness_m: float
    """Thickness of the skin and the tissue below it together."""
    limb_radius_m: float | None = None
    """Radius of a round limb's surface; None for flat ground."""
    poisson: float = POISSON


@dataclass(frozen=True, kw_only=True)
class Medium:
    ground: Ground
    skin: Skin
    tissue_pa: float
    """Young's modulus of the tissue under the skin."""


STEEPEST = 4.0
"""Slope (76 degrees) from which a round tool continues as a straight cone, so that its height is finite everywhere;
contact never reaches so far here."""
EDGE_M = 0.002
"""Radius of a disc's rounded rim, as in the simulator (``tissue/c/tool.c``)."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A rigid tool that is pressed into tissue, with its longer side across the limb, as the shipped cap is held."""

    name: str
    shape: Literal["ellipsoid", "disc"]
    semi_axes_m: tuple[float, float, float]
    """Semi-axes along, across and up; for a disc its radius, its radius again, and the radius of its rim."""

    @property
    def radius_m(self) -> float:
        """Radius of the circle with the tool's area as seen from above."""
        return float(np.sqrt(self.semi_axes_m[0] * self.semi_axes_m[1]))

    def height(self, along_m: Array, across_m: Array) -> Array:
        """Return the height above the tip [m], in the shape of the inputs."""
        a, b, up = self.semi_axes_m
        if self.shape == "ellipsoid":
            return _dome(np.hypot(along_m / a, across_m / b), up, STEEPEST * min(a, b) / up)
        r, face = np.hypot(along_m, across_m), a - up
        return _dome(np.maximum(r - face, 0.0) / up, up, STEEPEST)

    def reach_m(self, depth_m: float) -> float:
        """Return the distance from the axis up to which the tool can touch at this depth."""
        a, b, up = self.semi_axes_m
        if self.shape == "disc":
            return a
        sunk = min(depth_m / up, 1.0)
        return max(a, b) * float(np.sqrt(1 - (1 - sunk) ** 2))


def _dome(share: Array, up_m: float, steepest: float) -> Array:
    """Return the height of half an ellipse at a share of its half width, straight from a ``steepest`` slope on."""
    last = steepest / np.hypot(1.0, steepest)
    inside = np.minimum(share, last)
    return up_m * (1 - np.sqrt(1 - inside**2) + steepest * np.maximum(share - last, 0.0))


def ball(radius_m: float) -> Tool:
    return Tool(name=f"ball {1000 * radius_m:.1f} mm", shape="ellipsoid", semi_axes_m=(radius_m, radius_m, radius_m))


def disc(radius_m: float) -> Tool:
    edge = min(EDGE_M, radius_m)
    return Tool(name=f"disc {1000 * radius_m:.1f} mm", shape="disc", semi_axes_m=(radius_m, radius_m, edge))


CAP = Tool(name="cap", shape="ellipsoid", semi_axes_m=EMBODIMENTS["caps"].tip.half_m)
"""The shipped tool: an ellipsoid, wider across the limb than along it."""


DEPTHS_M = np.array([0.0005, 0.001, 0.002, 0.003, 0.004])
"""Depths past touch. A linear layer is used no deeper than 4 mm."""
TRAVEL_M = 0.006
"""Travel of a press past geometric touch, which comes before the force that counts as touch."""
TOUCH_N = 0.02
"""Force that counts as touch, on both sides."""
TOUCHES_N = (0.02, 0.05, 0.1)
"""No publication says at which force its depth is zero, so that comparisons with published curves are given for each of
these."""
DIMPLE_M = np.array([0.010, 0.015, 0.020])
"""Distances from the tool's axis at which the sunken surface is compared."""
BESIDE_M = np.array([0.015, 0.020, 0.025])
"""The same around a limb, where nearly incompressible tissue bulges."""
RINGS_M, RING_M = np.arange(0.004, 0.0301, 0.002), 0.002
"""The dimple at a distance is the mean over the surface within RING_M of it."""
RADII = (0.5, 1.0, 2.0)
"""Factors of an indenter's radius over which the exponent is taken."""
WAYS_M = np.r_[0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0] / 1000
"""Distances along the limb, or from head to foot over the abdomen, at which the force of a moved tool is given."""
TABLE_WAYS_M = np.array([0.0005, 0.001, 0.002, 0.010])


@dataclass(frozen=True, kw_only=True)
class Case:
    region: str
    reference: Reference
    """The published curve that gives the layer its modulus."""
    ground: Ground
    """Ground of the stored results. A comparison uses the thickness and the radius of the body that is compared."""
    main: Tool
    """The reference's own indenter."""
    more: tuple[Tool, ...] = ()

    def tools(self) -> dict[str, Tool]:
        """Every tool of this region by name: balls and discs of three sizes, those of further references, the cap."""
        sized = [make(factor * size) for make, size in ((ball, BALL_M), (disc, DISC_M)) for factor in RADII]
        return {tool.name: tool for tool in (*sized, *self.more, CAP)}

    @property
    def references(self) -> tuple[Tool, ...]:
        """The indenters of all published curves, some of them of other regions."""
        return ball(BALL_M), disc(DISC_M), disc(PROBE_M)

    def gliding(self) -> tuple[Tool, ...]:
        return self.main, CAP


def _size(reference: Reference) -> float:
    return reference.indenter.size_m or 0.0


BALL_M, DISC_M, PROBE_M = _size(ABDOMEN), _size(FOREARM), _size(UPPER_ARM_POSTERIOR)
"""Radii of the references' indenters: a ball of 10 mm, and discs with the area of ultrasound probes, 10.7 and 14.7
mm."""
CASES = (
    Case(region="abdomen", reference=ABDOMEN, ground=Ground(thickness_m=0.050), main=ball(BALL_M)),
    Case(
        region="forearm", reference=FOREARM, ground=Ground(thickness_m=0.018, limb_radius_m=0.034), main=disc(DISC_M)
    ),
    Case(
        region="upper_arm", reference=UPPER_ARM_ANTERIOR, ground=Ground(thickness_m=0.032, limb_radius_m=0.0475),
        main=disc(DISC_M), more=(disc(PROBE_M),),
    ),
)  # fmt: skip
"""The thickness of the arms is measured (MULTIS, Neumann et al. 2018), that of the abdomen assumed, all as in the
tissue sets. The radii of the limbs are those of man-adult, whose circumferences are 214 and 298 mm."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Presses with one tool, each from before touch on: one for finite elements, one for each place of a person."""

    presses: tuple[tuple[Array, Array], ...]
    """For each press, increasing travel past geometric touch (n,) [m] and force (n,) [N]."""

    def at(self, depths_m: Array, *, touch_n: float = TOUCH_N) -> Array:
        """Return the mean force (k,) [N] at depths past each press's touch, where it first exceeds ``touch_n``."""
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

    def shares(self, case: Case) -> Array:
        """Return the force (d,) of the reference's own indenter at DEPTHS_M, divided by that at the deepest of them."""
        force = self.curves[case.main.name].at(DEPTHS_M)
        return force / force[-1]

    def beside_at(self, distances_m: Array) -> Array:
        """Return the share (k,) of ``beside`` at these distances [m]."""
        return np.interp(distances_m, RINGS_M, self.beside)


def touch_m(travel_m: Array, force_n: Array, threshold_n: float) -> float:
    """Return the travel [m] at which a press first exceeds the threshold; CarecontactError if it never does."""
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
