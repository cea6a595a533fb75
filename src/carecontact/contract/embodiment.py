"""The robot of every trial: the single definition of its names, limits and tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

ToolName = Literal["caps", "mitt"]


@dataclass(frozen=True, kw_only=True)
class Tip:
    """The part of the hand that is meant to touch."""

    geom: str
    """Its name in the compiled model."""
    half_m: tuple[float, float, float]
    """Semi-axes of an ellipsoid in the hand's axes; y is along the finger pair, z out of the tool."""
    give_m3_n: float = 0.0
    """Compliance of the tip's own surface under pressure [m/Pa]; 0 means that it is rigid."""


@dataclass(frozen=True, kw_only=True)
class Embodiment:
    """The constants of a robot that the compiled model, the policies and the recordings share."""

    id: str
    """Its name in every recording and in the lock of every protocol."""
    joints: tuple[str, ...]
    """Names in the compiled model, from the base to the tool."""
    joint_low_rad: tuple[float, ...]
    joint_high_rad: tuple[float, ...]
    base_body: str
    """Body whose frame is the base frame."""
    tcp_site: str
    """Site at the tool centre point; its z axis points out of the tool."""
    tip: Tip
    tcp_z_m: float
    """Distance of the tool centre point, the tip's outermost point, from the hand's origin along the hand's z axis, out
    of the tool."""
    parked_joint_rad: tuple[float, ...]
    """Posture in which a trial begins unless its protocol gives another."""

    @property
    def tool_radius_m(self) -> float:
        """Half of the tip's smallest size."""
        return min(self.tip.half_m)

    @property
    def tip_centre_z_m(self) -> float:
        """Place of the tip's middle along the hand's z axis."""
        return self.tcp_z_m - self.tip.half_m[2]


PANDA = Embodiment(
    id="panda-closed-gripper-caps",
    joints=tuple(f"robot_joint{number}" for number in range(1, 8)),
    joint_low_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    joint_high_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    base_body="robot_base",
    tcp_site="tcp",
    tip=Tip(geom="robot_tool_cap", half_m=(0.012, 0.019, 0.012)),
    tcp_z_m=0.117,
    parked_joint_rad=(0.5324, -0.3907, 0.3589, -1.8387, 0.1348, 1.4716, 1.1415),
)
"""Franka Emika Panda; joint limits as in the franka description package, from which the arm's meshes come too. The
hand is permanently closed: a cap covers the fingertips. The cap is an ellipsoid, because an ellipsoid has
no rims and no flat sides: the compiled tissue meets it in one point of each triangle, and the force does not jump where
skin slides over it."""

PANDA_MITT = replace(
    PANDA,
    id="panda-mitt",
    tip=Tip(geom="robot_tool_pad", half_m=(0.025, 0.035, 0.010), give_m3_n=4e-7),
)
"""The same arm and hand with a wash mitt over the fingers: a rounded pad of 50 x 70 mm, 20 mm thick, about as large as
the flat of three fingers. It is an ellipsoid like the cap and no box: skin that sinks into a soft box farther than its
rims are round would be pressed against the walls. Its pile gives way by 2 mm under 5 kPa, which is assumed: terry cloth
of 3 to 5 mm loses about half of its thickness between 0.05 and 5 kPa, the range of the textile industry's compression
test (KES-FB3)."""

EMBODIMENTS: dict[ToolName, Embodiment] = {"caps": PANDA, "mitt": PANDA_MITT}
"""``scene.tool`` of a protocol -> the robot."""
