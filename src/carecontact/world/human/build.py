"""How thick and how stiff the tissue of a body is that is slimmer or heavier than the one that a row of tissue is of.

A row names the body mass index of its person. Over another one's bones, the tissue is thicker or thinner by what
ultrasound and weight gain say, and its law is weaker or stronger by what finite elements give for that thickness. The
modulus stays: no publication was found that tells how it depends on build.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.world.human.body import Body

LEAST_BMI, MOST_BMI = 18.5, 40.0
"""[kg/m^2] Thickness grows between these; a body outside has that of the nearer one (assumed)."""


@dataclass(frozen=True, kw_only=True)
class Growth:
    """What one kg/m^2 more does to a region."""

    thickness_m: float
    """Per kg/m^2."""
    weakening: float
    """Force falls with thickness to this power. By finite elements with the middle skin (``validation.fem``), 4 mm past
    touch, the region's reference indenter, and the thickness of a BMI of 32 against that of man-adult."""
    source: str


_ARM_FAT = (
    "fat behind the upper arm of 3.7 mm below a BMI of 25 and 5.1 mm above 30 (Cotofana et al. 2020), taken as "
    "10 kg/m2 apart (assumed)"
)
GROWTH = {
    "forearm": Growth(thickness_m=0.00014, weakening=1.02, source=f"as on the upper arm (assumed): {_ARM_FAT}"),
    "upper_arm": Growth(thickness_m=0.00014, weakening=0.60, source=_ARM_FAT),
    "abdomen": Growth(
        thickness_m=0.0012, weakening=0.16,
        source="20 kg more add 2 to 14 mm to the trunk's soft tissue: their middle, at man-adult's stature",
    ),
}  # fmt: skip
"""Region -> its growth. Any other region has the thickness and the law of its row on every body."""


def rounded_bmi(body: Body) -> float:
    """To a tenth, as rows of tissue name it [kg/m^2]."""
    return round(body.bmi, 1)


def tissue_of(body: Body, region: str, row: Tissue) -> Tissue:
    """The tissue of a region on a body: the row itself where it is of this build, or names none.

    Thickness changes, and with it the law by one factor at every depth, so that it stays convex; the damping keeps its
    ratio to the critical one. The depth to which the law was measured stays.
    """
    if row.bmi_kg_m2 is None or region not in GROWTH or row.bmi_kg_m2 == (bmi := rounded_bmi(body)):
        return row
    growth = GROWTH[region]
    own, theirs = (float(np.clip(value, LEAST_BMI, MOST_BMI)) for value in (bmi, row.bmi_kg_m2))
    thickness_m = max(row.thickness_m + growth.thickness_m * (own - theirs), row.measured_depth_m)
    factor = float((thickness_m / row.thickness_m) ** -growth.weakening)
    return stiffened(row, factor).model_copy(update={"thickness_m": thickness_m, "bmi_kg_m2": bmi})


def stiffened(row: Tissue, factor: float) -> Tissue:
    """A law that is ``factor`` times as strong at every depth, and as convex; its damping is as far from critical."""
    rooted = ("damping_ns_m3", "damping_growth_ns_m4")
    changed = {name: factor * getattr(row, name) for name in ("a_n_m3", "b_n_m4", "c_n_m5")}
    return row.model_copy(update={**changed, **{name: factor**0.5 * getattr(row, name) for name in rooted}})
