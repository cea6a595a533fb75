"""When a segment counts as touched, and where success may be earned."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from carecontact.contract.protocol.section import Positive, Section
from carecontact.contract.protocol.task import RegionName
from carecontact.regions import SEGMENTS


def _segment(name: str) -> str:
    if name not in SEGMENTS:
        raise ValueError(f"no segment named {name!r}; valid: {', '.join(SEGMENTS)}")
    return name


SegmentName = Annotated[str, AfterValidator(_segment)]
"""One of ``carecontact.regions.SEGMENTS``."""


class ContactDefinition(Section):
    version: Literal["contact-v1"]
    on_n: Positive
    off_n: Positive
    filter_hz: Positive
    filter_order: Literal[2]
    valid_total_s: Positive
    episode_gap_s: Positive
    stroke_sample_hz: Positive
    stroke_filter_hz: Positive
    reversal_m: Positive
    active_speed_m_s: Positive
    active_rotation_rad_s: Positive
    peak_filter_hz: Positive
    neighbourhood: dict[RegionName, Annotated[list[SegmentName], Field(min_length=1)]]
    """Region -> segments on which C3 may be earned."""
