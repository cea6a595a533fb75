"""The answers of the finite elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.errors import CarecontactError
from carecontact.sim.bench import Indenter
from carecontact.validation.fem.answer import Answer, Curve
from carecontact.validation.fem.cases import BALL, Case
from carecontact.validation.fem.contact import press, press_sticking
from carecontact.validation.fem.layer import FINE_M, layer
from carecontact.validation.fem.materials import MATCHED_M, POISSON, Skin
from carecontact.validation.fem.profiles import Profile, on_a_cylinder, profile
from carecontact.validation.fem.surface import Surface

TRAVELS_M = np.r_[np.linspace(0.0, 0.001, 11), np.linspace(0.0012, 0.006, 25)]
"""Depths past geometric touch at which a press is solved."""
REACH_M = 0.026
FIRST_GUESS_PA = 15e3
RATIO_POWER = 0.35
"""About the power of the skin's relative modulus with which a layer's force grows; it only speeds the search up."""
MATCHED, MOST_SOLVES = 0.002, 12


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The layer's shape and material, apart from its skin and its stiffness."""

    thickness_m: float
    limb_radius_m: float | None = None
    """Of a round limb; None: flat."""
    poisson: float = POISSON
    fine_m: float = FINE_M

    def shape(self, indenter: Indenter) -> Profile:
        """The indenter's surface over the layer's."""
        own = profile(indenter)
        return own if self.limb_radius_m is None else on_a_cylinder(own, self.limb_radius_m)


def answer(case: Case, skin: Skin, ground: Ground) -> Answer:
    """How a layer with this skin answers, its tissue as stiff as the reference's middle curve asks.

    Raises CarecontactError if no modulus of the tissue does.
    """
    surface, modulus = matched(case, skin, ground)
    curves = {name: pressed(surface, ground.shape(indenter)) for name, indenter in case.indenters().items()}
    deepest = press(surface, ground.shape(case.reference.indenter), MATCHED_M)
    return Answer(
        curves=curves, dimple_m=surface.dimple(deepest.nodal_n), dimple_at_m=surface.outline_m,
        dimple_travel_m=MATCHED_M, modulus_pa=modulus,
    )  # fmt: skip


def matched(case: Case, skin: Skin, ground: Ground) -> tuple[Surface, float]:
    """The layer and its tissue's modulus [Pa], with the force of the reference at MATCHED_M past touch."""
    reference, shape = case.reference, ground.shape(case.reference.indenter)
    wanted = float(np.interp(MATCHED_M, reference.depth_m, reference.force_n))
    modulus = FIRST_GUESS_PA
    for _ in range(MOST_SOLVES):
        unit = layer(
            thickness_m=ground.thickness_m, poisson=ground.poisson, skin_m=skin.thickness_m,
            skin_ratio=skin.modulus_pa / modulus, reach_m=REACH_M, fine_m=ground.fine_m,
        )  # fmt: skip
        surface = unit.scaled(modulus)
        force = float(pressed(surface, shape).at(np.array([MATCHED_M]))[0])
        if abs(force / wanted - 1) < MATCHED:
            return surface, modulus
        # The skin's share of the force does not follow the tissue's modulus.
        modulus *= (wanted / force) ** (1 / (1 - RATIO_POWER) if skin.thickness_m else 1.0)
    raise CarecontactError(
        f"finite elements: no modulus of the {case.region}'s tissue gives {wanted:.2f} N under a skin of "
        f"{1000 * skin.thickness_m:.1f} mm and {skin.modulus_pa / 1e6:.2f} MPa"
    )


def pressed(surface: Surface, shape: Profile) -> Curve:
    """A frictionless press through TRAVELS_M."""
    return Curve(presses=((TRAVELS_M, np.array([press(surface, shape, float(d)).force_n for d in TRAVELS_M])),))


def sticking_gain(case: Case, skin: Skin, ground: Ground) -> float:
    """Force of the 10 mm ball at MATCHED_M past geometric touch if it never slips, over the frictionless one. Of the
    ball alone: a disc with a rounded rim has nodes at its rim that find no balance without slip."""
    surface, _ = matched(case, skin, ground)
    shape = ground.shape(BALL)
    stuck = press_sticking(surface, shape, np.linspace(0.0, MATCHED_M, 17)[1:])[-1]
    return stuck.force_n / press(surface, shape, MATCHED_M).force_n
