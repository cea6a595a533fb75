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

PILE_M3_N, FOAM_M3_N = 4e-7, 1e-7
"""[m/Pa] How far pile and foam of the wash mitt give way under pressure. docs/tissue.md says what is from sources.

The pile is terry cloth of 4 mm; piles are 2.5 to 9 mm high. It gives way by half, 2 mm, under 5 kPa, the largest
pressure of the textile industry's test of compression (KES-FB3). That half is assumed.

The foam is 10 mm of flexible polyurethane. Open cells have the modulus E = E_s r^2 and collapse at 0.05 E_s r^2, where
r is the foam's density over the solid's, 1,200 kg/m^3, and E_s that of the solid, 45 MPa (Gibson and Ashby, Cellular
Solids, 1997). It must not collapse where a nurse wipes, so that it bears 5 kPa: r = 0.047, 57 kg/m^3, E = 100 kPa."""
PANDA_MITT = replace(
    PANDA,
    id="panda-mitt",
    tip=Tip(geom="robot_tool_pad", half_m=(0.025, 0.035, 0.014), give_m3_n=PILE_M3_N + FOAM_M3_N),
)
"""The same arm and hand with a wash mitt over the fingers: a rounded pad of 50 x 70 mm, about as large as the flat of
three fingers, and 28 mm thick, so that pile and foam lie over a stiff core. It is an ellipsoid like the cap and no box:
skin that sinks into a soft box farther than its rims are round would be pressed against the walls."""

EMBODIMENTS: dict[ToolName, Embodiment] = {"caps": PANDA, "mitt": PANDA_MITT}
"""``scene.tool`` of a protocol -> the robot."""
