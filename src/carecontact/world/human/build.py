"""Thickness and stiffness of the tissue of a body that is slimmer or heavier than the person of a tissue row.

A row names the body mass index of its person. For another body, the tissue is thicker or thinner according to
ultrasound and weight gain, and its law is weaker or stronger according to finite elements of that thickness. The
modulus is unchanged: no publication was found on how it depends on build.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.world.human.body import Body

LEAST_BMI, MOST_BMI = 18.5, 40.0
"""Range [kg/m^2] in which thickness depends on the body mass index; outside, it stays at the nearer end's (assumed)."""


@dataclass(frozen=True, kw_only=True)
class Growth:
    """The effect of one more kg/m^2 on a region."""

    thickness_m: float
    """Thickness gained for each kg/m^2."""
    weakening: float
    """Force falls with thickness to this power. It comes from finite elements with the middle skin
    (``validation.fem``): force at 4 mm past touch of the region's reference indenter, thickness at a BMI of 32 against
    man-adult's."""
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
    """Return the body mass index [kg/m^2] rounded to a tenth, as rows of tissue name it."""
    return round(body.bmi, 1)


def tissue_of(body: Body, region: str, row: Tissue) -> Tissue:
    """Return the tissue of a region on a body: the row itself if it is for this build or names none.

    The thickness changes and scales the law by one factor at every depth, so that it stays convex. The damping keeps
    its ratio to critical damping. The depth to which the law was measured is unchanged.
    """
    if row.bmi_kg_m2 is None or region not in GROWTH or row.bmi_kg_m2 == (bmi := rounded_bmi(body)):
        return row
    growth = GROWTH[region]
    own, theirs = (float(np.clip(value, LEAST_BMI, MOST_BMI)) for value in (bmi, row.bmi_kg_m2))
    thickness_m = max(row.thickness_m + growth.thickness_m * (own - theirs), row.measured_depth_m)
    factor = float((thickness_m / row.thickness_m) ** -growth.weakening)
    return stiffened(row, factor).model_copy(update={"thickness_m": thickness_m, "bmi_kg_m2": bmi})


def stiffened(row: Tissue, factor: float) -> Tissue:
    """Return a row whose law is ``factor`` times as strong at every depth and whose damping ratio is the same."""
    rooted = ("damping_ns_m3", "damping_growth_ns_m4")
    changed = {name: factor * getattr(row, name) for name in ("a_n_m3", "b_n_m4", "c_n_m5")}
    return row.model_copy(update={**changed, **{name: factor**0.5 * getattr(row, name) for name in rooted}})
