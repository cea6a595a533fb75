"""Bed, arm board, robot base and cameras."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from carecontact.contract.embodiment import EMBODIMENTS, Robot
from carecontact.contract.protocol.section import Positive, Section, Vec3, registered


class Camera(Section):
    position_m: Vec3
    look_at_m: Vec3
    up: Vec3
    fovy_deg: Positive
    width: Annotated[int, Field(gt=0, le=1280)]
    height: Annotated[int, Field(gt=0, le=960)]
    mount: Literal["world", "hand"] = "world"


class Scene(Section):
    mattress_top_m: float
    robot_base_m: Vec3
    robot_yaw_deg: float
    parked_joint_rad: tuple[float, ...]
    board_low_m: tuple[float, float]
    """Arm board: low corner (x, y), world."""
    board_high_m: tuple[float, float]
    board_friction: Positive
    tool: Annotated[str, AfterValidator(registered(EMBODIMENTS))] = "caps"
    """The robot, named by what its hand wears: a rigid cap over the fingertips, or a soft wash mitt
    (``contract.embodiment``)."""

    @property
    def robot(self) -> Robot:
        return EMBODIMENTS[self.tool]

    @model_validator(mode="after")
    def _one_angle_for_each_joint(self) -> Self:
        if (count := len(self.robot.joints)) != len(self.parked_joint_rad):
            raise ValueError(f"parked_joint_rad: expected {count} angles [rad], got {len(self.parked_joint_rad)}")
        return self
