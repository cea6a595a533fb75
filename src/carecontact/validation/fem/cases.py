"""What is compared: the regions with a published curve, the tools, the depths and the places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.validation.fem.ground import Ground
from carecontact.validation.fem.tools import CAP, Tool, ball, disc
from carecontact.validation.reference import ABDOMEN, FOREARM, UPPER_ARM_ANTERIOR, UPPER_ARM_POSTERIOR, Reference

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
TOLD_WAYS_M = np.array([0.0005, 0.001, 0.002, 0.010])


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
        """The tools that are moved along the surface."""
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
