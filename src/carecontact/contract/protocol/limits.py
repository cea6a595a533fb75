"""Force limits of the body segments."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from carecontact.contract.protocol.section import Section

SEGMENT_PARTS = (
    "pelvis", "abdomen", "thorax", "neck", "head", "upper_arm", "forearm", "hand", "thigh", "shank", "foot",
)  # fmt: skip
"""Names that limits can be given for: the segments of a recording without their sides."""


class ForceLimits(Section):
    pack: str
    source: str
    gamma: Annotated[float, Field(gt=0, le=1)]
    """gamma': the safety gate is at this share of F_pain."""
    f_pain_n: dict[str, float]
    """One of SEGMENT_PARTS -> F_pain [N]; segments not named take the strictest entry and are flagged."""


def sideless(segment: str) -> str:
    """``right_forearm`` and ``left_forearm`` -> ``forearm``."""
    return segment.removeprefix("right_").removeprefix("left_")
