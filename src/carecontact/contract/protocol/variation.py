"""What the seed of a trial changes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from carecontact.contract.protocol.parking import Parking
from carecontact.contract.protocol.section import Section

DRAWN = ("bodies", "shoulder_rotation_deg", "palm_deg", "place_toward_head_m", "overhead_shift_m", "overhead_turn_deg",
         "parking")  # fmt: skip
"""Fields that change the compiled model with the seed."""
Angles = tuple[float, float]


def _ordered(pair: Angles) -> Angles:
    if not -180 <= pair[0] <= pair[1] <= 180:
        raise ValueError(f"expected [low, high] degrees, low at most high, got [{pair[0]:g}, {pair[1]:g}]")
    return pair


class Randomization(Section):
    seeds: list[int]
    comfort_arm_deg: tuple[float, float]
    """Angle between the humerus' long axis and the trunk's in the frontal plane; uniform over this range."""
    drawn_as: str = ""
    """Name from which seeds draw, in place of the protocol's id: a draft that is renamed when it is frozen keeps its
    persons."""


class Variation(Section):
    """What else a seed changes; by default nothing. Contact and motion of the person against the bed stay."""

    appearance: Literal["baked", "varied-v1"] = "baked"
    """Skin tone, clothes and hair: the body's own, or drawn (``world.human.appearance``)."""
    light: Literal["fixed", "varied-v1"] = "fixed"
    """Strength, direction and colour: ``world.light``."""
    depth_noise: Literal["none", "structured-light-v1"] = "none"
    """``observation.sensor_noise``"""
    encoder_noise_rad: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Standard deviation, every joint and reading on its own; joint speeds stay."""
    place_along_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """The person, with pillow and arm board, lies elsewhere on the bed: uniform up to so far either way along it."""
    place_across_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """The same across the bed."""
    place_yaw_deg: Annotated[float, Field(ge=0, le=15)] = 0.0
    """The same, turned about the vertical through the right shoulder (``world.place``)."""
    calibration_m: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    """Standard deviation of the error with which the cell knows where each fixed camera is, along each axis."""
    calibration_deg: Annotated[float, Field(ge=0, le=5)] = 0.0
    """The same about each axis of the camera (``observation.calibration``)."""
    tissue: Literal["declared", "published-v1"] = "declared"
    """How stiff the soft regions are: as ``person.tissue`` says, or that times a factor that is drawn from published
    differences between people (``world.human.spread``)."""
    place_toward_head_m: Annotated[float | None, Field(ge=0, le=0.1)] = None
    """Farthest toward the head, where that is less than ``place_along_m``: patients slide down in bed, not up."""
    bodies: tuple[str, ...] = ()
    """The person is one of these: a block of as many seeds has each of them once, in an order of its own. Without any
    it is ``person.body``."""
    shoulder_rotation_deg: Annotated[Angles, AfterValidator(_ordered)] = (0.0, 0.0)
    """Added to ``person.shoulder_rotation_deg``; uniform over this range."""
    palm_deg: Annotated[Angles, AfterValidator(_ordered)] = (0.0, 0.0)
    """Added to ``person.palm_deg``; uniform over this range."""
    overhead_shift_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """The overhead camera is mounted elsewhere: uniform up to so far either way along each axis of the world."""
    overhead_turn_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """The same, turned about each axis of the camera."""
    parking: Parking | None = None
    """The places where the robot may stand; without it, the robot stands at ``scene.robot_base_m``."""

    @property
    def sensor_noise(self) -> bool:
        """Whether the protocol adds noise to what the policy's sensors read."""
        return self.depth_noise != "none" or self.encoder_noise_rad > 0

    @property
    def draws_models(self) -> bool:
        """Whether trials of one region and several seeds have several compiled models."""
        return any(getattr(self, name) != type(self).model_fields[name].default for name in DRAWN)
