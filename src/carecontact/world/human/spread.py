"""How much people's tissue differs in stiffness, as a distribution from which a seed can draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.world.human.build import stiffened

P95 = 1.6448536269514722
"""The 95th percentile of the standard normal distribution."""
WIDEST = 2.0
"""Largest deviate [standard deviations]: draws beyond it are set to it, since no publication says how far the tails
reach."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Distribution over people of the factor of a law; its median is 1."""

    p5: float
    p95: float
    together: str
    """Regions with the same word share one draw: a person with a soft forearm has a soft upper arm (assumed)."""
    source: str

    def factor(self, deviate: float) -> float:
        """Return the factor at a standard normal deviate.

        Its logarithm is normal with different widths below and above the median, so that the 5th, 50th and 95th
        percentile are the published ones.
        """
        z = float(np.clip(deviate, -WIDEST, WIDEST))
        return float((self.p95 if z > 0 else 1 / self.p5) ** (z / P95))


_MULTIS = "secant stiffness, 91-95 adults: MULTIS (Neumann et al. 2018, Sci Data 5:180193; 2019, J Biomech 95:109307)"
SPREADS = {
    "forearm": Spread(
        p5=0.7445 / 1.1903, p95=2.1519 / 1.1903, together="arm", source=f"{_MULTIS}, anterior forearm"
    ),
    "upper_arm": Spread(
        p5=0.4341 / 0.6445, p95=1.4601 / 0.6445, together="arm", source=f"{_MULTIS}, anterior upper arm"
    ),
    "abdomen": Spread(
        p5=6.4795 / 7.9611, p95=9.3256 / 7.9611, together="trunk",
        source="force at 22 mm of ten men, mean of sites R1-R5: Remus et al. 2024, Front Bioeng Biotechnol 12:1384062, "
        "supplement S1",
    ),
}  # fmt: skip
"""Region -> its spread. The tissue of any other region is not varied."""


def draw_tissue(rng: np.random.Generator, rows: Mapping[str, Tissue]) -> dict[str, Tissue]:
    """Draw one person's tissue: the rows of the regions in SPREADS, each made softer or stiffer by a drawn factor."""
    words = sorted({spread.together for spread in SPREADS.values()})
    deviates = dict(zip(words, rng.standard_normal(len(words)).tolist(), strict=True))
    return {
        region: stiffened(row, spread.factor(deviates[spread.together]))
        for region, row in rows.items()
        if (spread := SPREADS.get(region)) is not None
    }
