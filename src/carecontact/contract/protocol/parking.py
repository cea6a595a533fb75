"""The places where the robot may stand beside the bed, and what a place must let it do."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.contract.protocol.section import Section, Vec3


class Parking(Section):
    """A base is drawn, and drawn again, until it serves the task's region (``episode.parking``).

    A base's height is against a bed that stays: a lower base is a bed raised against the robot.
    """

    manner: Literal["nearest", "anywhere"]
    """``nearest``: the draws begin at ``centre`` and spread from there, so that the robot moves no farther than this
    person needs. ``anywhere``: every draw is uniform over the whole spread, as if someone had rolled the robot there.
    """
    centre_m: Vec3
    """World."""
    centre_yaw_deg: float
    spread_m: tuple[Annotated[float, Field(ge=0, le=0.5)], Annotated[float, Field(ge=0, le=0.5)],
                    Annotated[float, Field(ge=0, le=0.5)]]  # fmt: skip
    """Up to so far either way along each axis of the world."""
    spread_yaw_deg: Annotated[float, Field(ge=0, le=45)]
    tries: Annotated[int, Field(ge=1, le=10_000)] = 1000
    """A person for whom no base serves after so many draws is drawn anew."""
