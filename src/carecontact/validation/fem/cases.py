"""What is compared: the regions with a published curve, the indenters, the depths and the places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.sim.bench import Indenter
from carecontact.validation.reference import ABDOMEN, FOREARM, Reference

DEPTHS_M = np.array([0.0005, 0.001, 0.002, 0.003, 0.004])
"""Past touch. A linear layer is used no deeper than 4 mm."""
TOUCH_N = 0.02
"""Force that counts as touch, on both sides."""
LATE_TOUCH_N = 0.1
"""Another touch, to see how far the curves depend on it."""
DIMPLE_M = np.array([0.010, 0.015, 0.020])
"""Distances from the indenter's axis at which the sunken surface is compared."""
RADII = (0.5, 1.0, 2.0)
"""Factors of an indenter's radius over which the exponent is taken."""


@dataclass(frozen=True, kw_only=True)
class Case:
    region: str
    reference: Reference
    """The published curve that gives the layer its modulus."""
    limb: bool
    """Whether the region is round, and not nearly flat."""

    def indenters(self) -> dict[str, Indenter]:
        """Every indenter of this region by name: balls and discs of three sizes, and the shipped cap."""
        found = {}
        for word, middle in (("ball", BALL), ("disc", DISC)):
            for factor in RADII:
                size = factor * (middle.size_m or 0.0)
                found[f"{word} {1000 * size:.1f} mm"] = Indenter(shape=middle.shape, size_m=size)
        return {**found, "cap": Indenter(shape="cap")}

    def main(self) -> str:
        """Name of the reference's own indenter."""
        return next(name for name, indenter in self.indenters().items() if indenter == self.reference.indenter)


BALL, DISC = ABDOMEN.indenter, FOREARM.indenter
"""The references' own indenters: a ball of 10 mm radius, and a disc of 10.7 mm."""
CASES = (Case(region="abdomen", reference=ABDOMEN, limb=False), Case(region="forearm", reference=FOREARM, limb=True))
