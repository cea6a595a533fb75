"""What the seed of a trial changes."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from carecontact.contract.protocol.section import Section

LATER = ("calibration_m", "calibration_deg", "tissue")
"""Fields that protocols did not always have."""


class Randomization(Section):
    seeds: list[int]
    comfort_arm_deg: tuple[float, float]
    """Angle between the humerus' long axis and the trunk's in the frontal plane; uniform over this range."""


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

    @model_serializer(mode="wrap")
    def _spelled(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what protocols did not always have, at its default: they keep their hash."""
        content, fields = handler(self), type(self).model_fields
        for name in LATER:
            if getattr(self, name) == fields[name].default:
                del content[name]
        return content

    @property
    def sensor_noise(self) -> bool:
        """Whether the protocol adds noise to what the policy's sensors read."""
        return self.depth_noise != "none" or self.encoder_noise_rad > 0
