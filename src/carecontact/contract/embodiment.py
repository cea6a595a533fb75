"""The robot of every trial: the single definition of its names, limits and tool."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Embodiment:
    """Constants of a robot, as the compiled model, the policies and the recordings know them."""

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
    cap_semi_axes_m: tuple[float, float, float]
    """Of the ellipsoid over the closed fingertips, in the hand's axes; widest along the finger pair."""
    cap_centre_z_m: float
    """Along the hand's z axis, which points out of the tool."""
    parked_joint_rad: tuple[float, ...]
    """Posture in which a trial begins unless its protocol gives another."""

    @property
    def tool_radius_m(self) -> float:
        """Smallest radius of the cap."""
        return min(self.cap_semi_axes_m)

    @property
    def tcp_z_m(self) -> float:
        """Distance of the tool centre point, the cap's outermost point, from the hand's origin."""
        return self.cap_centre_z_m + self.tool_radius_m


PANDA = Embodiment(
    id="panda-closed-gripper-caps",
    joints=tuple(f"robot_joint{number}" for number in range(1, 8)),
    joint_low_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    joint_high_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    base_body="robot_base",
    tcp_site="tcp",
    cap_semi_axes_m=(0.012, 0.019, 0.012),
    cap_centre_z_m=0.105,
    parked_joint_rad=(0.5324, -0.3907, 0.3589, -1.8387, 0.1348, 1.4716, 1.1415),
)
"""Franka Emika Panda; joint limits as in the franka description package, from which the arm's meshes come too. The
hand is permanently closed: a cap covers the fingertips. The cap is an ellipsoid, because an ellipsoid makes one contact
with each triangle of a shell; a capsule made up to five, some of them millimetres too deep."""
