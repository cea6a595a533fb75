"""Bed, arm board, robot base and cameras."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.contract.embodiment import ToolName
from carecontact.contract.protocol.section import Positive, Section, Vec3


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
    parked_joint_rad: tuple[float, float, float, float, float, float, float]
    board_low_m: tuple[float, float]
    """Arm board: low corner (x, y), world."""
    board_high_m: tuple[float, float]
    board_friction: Positive
    tool: ToolName = "caps"
    """What the hand wears: a rigid cap over the fingertips, or a soft wash mitt (``contract.embodiment``)."""
