"""Published human force-indentation curves that the person is compared with. Loading only; no manikin was measured.

Limbs: derived from the MULTIS in-vivo ultrasound indentation study (Neumann et al. 2018, Sci Data 5:180193; 2019,
J Biomech 95:109307), 91 to 95 adults a site, flat ultrasound probe, here a disc of the same area. The secant stiffness
and its P5-P95 are measured; the curvature of F = a d + b d^2 is inferred from two R-squared values. The band scales the
median curve by the secant's percentiles.

Abdomen: Remus et al. 2024, Front Bioeng Biotechnol 12:1384062, supplement S1 (CC BY 4.0): hemisphere of 10 mm radius at
5 mm/s, relaxed, ten men, mean of sites R1 to R5 and of the participants.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carecontact.sim.bench import Indenter
from carecontact.validation.result import Array

SPEED_M_S = 0.005


@dataclass(frozen=True, kw_only=True)
class Reference:
    name: str
    region: str
    """Region whose shell is pressed for the comparison."""
    indenter: Indenter
    depth_m: Array
    """(n,) from 0 to the largest depth measured (limbs: the median subject's)."""
    force_n: Array
    """(n,) median (limbs) or mean (abdomen) force"""
    low_n: Array
    """(n,) P5"""
    high_n: Array
    """(n,) P95"""

    def times(self, factor: float) -> Reference:
        """Return the reference with the middle curve multiplied by a factor; its band is unchanged."""
        return replace(self, force_n=factor * self.force_n)


def _limb(
    name: str, region: str, *, area_mm2: float, a: float, b: float, secant: tuple[float, float, float], depth_mm: float
) -> Reference:
    """Make a limb's reference. ``a`` [N/mm] and ``b`` [N/mm^2] belong to the median curve; ``secant`` is its stiffness
    at P5, median and P95 [N/mm].
    """
    depth = np.linspace(0.0, depth_mm, 19)
    force = a * depth + b * depth**2
    low, middle, high = secant
    return Reference(
        name=name, region=region, depth_m=depth / 1000, force_n=force, low_n=force * low / middle,
        high_n=force * high / middle, indenter=Indenter(shape="flat", size_m=float(np.sqrt(area_mm2 / np.pi)) / 1000),
    )  # fmt: skip


FOREARM = _limb(
    "forearm, anterior (MULTIS LA_A)", "forearm", area_mm2=360.0, a=0.8615, b=0.07327, secant=(0.7445, 1.1903, 2.1519),
    depth_mm=4.487,
)  # fmt: skip
FOREARM_POSTERIOR = _limb(
    "forearm, posterior (MULTIS LA_P)", "forearm", area_mm2=360.0, a=1.0018, b=0.11113, secant=(0.8053, 1.4693, 2.7353),
    depth_mm=4.207,
)  # fmt: skip
UPPER_ARM_ANTERIOR = _limb(
    "upper arm, anterior (MULTIS UA_A)", "upper_arm", area_mm2=360.0, a=0.3893, b=0.03126,
    secant=(0.4341, 0.6445, 1.4601), depth_mm=8.163,
)  # fmt: skip
UPPER_ARM_POSTERIOR = _limb(
    "upper arm, posterior (MULTIS UA_P)", "upper_arm", area_mm2=675.0, a=0.5414, b=0.03211,
    secant=(0.3890, 0.7968, 1.3969), depth_mm=7.951,
)  # fmt: skip

_ABDOMEN = np.array([
    [0.0, 0.0, 0.0, 0.0], [2.0, 0.4109, 0.3622, 0.4742], [4.0, 0.8700, 0.7574, 1.0022], [6.0, 1.3780, 1.1852, 1.5921],
    [8.0, 1.9381, 1.6594, 2.2478], [10.0, 2.5557, 2.1901, 2.9739], [12.0, 3.2381, 2.7861, 3.7770],
    [14.0, 3.9940, 3.4453, 4.6778], [16.0, 4.8334, 4.1537, 5.6714], [18.0, 5.7668, 4.8728, 6.7677],
    [20.0, 6.8057, 5.6465, 7.9827], [22.0, 7.9611, 6.4795, 9.3256],
])  # fmt: skip
"""Depth [mm], force, P5, P95 [N]."""
ABDOMEN = Reference(
    name="abdomen, R1-R5 (Remus 2024)", region="abdomen", indenter=Indenter(shape="hemisphere", size_m=0.010),
    depth_m=_ABDOMEN[:, 0] / 1000, force_n=_ABDOMEN[:, 1], low_n=_ABDOMEN[:, 2], high_n=_ABDOMEN[:, 3],
)  # fmt: skip

FITTED: dict[str, tuple[Reference, ...]] = {
    "paper-mapping": (FOREARM, ABDOMEN),
    "human-published": (FOREARM, UPPER_ARM_ANTERIOR, ABDOMEN),
}
"""Tissue set -> the curves to whose middles its laws were fitted; they are compared at places that no fit used."""
REFERENCES = (FOREARM, FOREARM_POSTERIOR, UPPER_ARM_ANTERIOR, UPPER_ARM_POSTERIOR, ABDOMEN)
"""All references; those to which a set was not fitted are shown beside it. The free side of the shell is pressed,
whichever side of the limb was measured."""
