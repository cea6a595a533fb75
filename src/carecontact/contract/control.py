"""The controllers that may execute a policy's actions, by the id that a card gives as ``control``."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.errors import ConfigError
from carecontact.registry import Registry

CARTESIAN_IMPEDANCE = "cartesian-impedance"
"""Id of the controller of poses, which a card has unless it names another."""


@dataclass(frozen=True, kw_only=True)
class JointImpedance:
    """Gains of ``tau = (J^T Kx J + Kq)(q_d - q) - (J^T Kxd J + Kqd) qdot + coriolis``, J at the robot's flange.

    The torque is limited joint by joint; gravity is compensated beside it.
    """

    stiffness_nm_rad: tuple[float, ...]
    """(joints,) Kq"""
    damping_nms_rad: tuple[float, ...]
    """(joints,) Kqd"""
    cartesian_stiffness: tuple[float, ...] = (0.0,) * 6
    """(6,) Kx: x y z [N/m], then about x y z [N m/rad]"""
    cartesian_damping: tuple[float, ...] = (0.0,) * 6
    """(6,) Kxd [N s/m], [N m s/rad]"""
    torque_limit_nm: tuple[float, ...]
    """(joints,)"""
    velocity_limit_rad_s: tuple[float, ...]
    """(joints,) The benchmark stops a trial in which a joint is faster, as the robot would stop."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a wrong count or a negative number."""
        for name, values in vars(self).items():
            count = 6 if name.startswith("cartesian") else len(self.stiffness_nm_rad)
            if len(values) != count or not all(value >= 0 for value in values):
                raise ConfigError(f"JointImpedance.{name}: expected {count} numbers of at least 0, got {values}")


@dataclass(frozen=True, kw_only=True)
class Control:
    description: str
    joint: JointImpedance | None
    """Gains of a joint controller; None for the Cartesian impedance, whose gains are the protocol's."""


CONTROLS: Registry[Control] = Registry("control", row=Control)
CONTROLS.register(
    CARTESIAN_IMPEDANCE,
    Control(description="Springs and dampers between the tool and a target pose; gains of the protocol.", joint=None),
)

CONTROLS.register(
    "droid",
    Control(
        description="Joint impedance of DROID's robots, with its Cartesian part.",
        # Gains and limits: droid-dataset/droid, config/panda/franka_hardware.yaml (default_Kq to default_Kxd and
        # limits); the law: HybridJointImpedanceControl of polymetis (facebookresearch/fairo).
        joint=JointImpedance(
            stiffness_nm_rad=(40, 30, 50, 25, 35, 25, 10),
            damping_nms_rad=(4, 6, 5, 5, 3, 2, 1),
            cartesian_stiffness=(400, 400, 400, 15, 15, 15),
            cartesian_damping=(37, 37, 37, 2, 2, 2),
            torque_limit_nm=(86.0,) * 4 + (11.5,) * 3,
            velocity_limit_rad_s=(2.075,) * 4 + (2.51,) * 3,
        ),
    ),
)
CONTROLS.register(
    "droid-sim-evals",
    Control(
        description="Stiff joint servos, as community simulations of DROID have them (400 N m/rad, 80 N m s/rad).",
        # Gains and limits: arhanjain/sim-evals, src/environments/nvidia_droid.py.
        joint=JointImpedance(
            stiffness_nm_rad=(400,) * 7,
            damping_nms_rad=(80,) * 7,
            torque_limit_nm=(87.0,) * 4 + (12.0,) * 3,
            velocity_limit_rad_s=(2.175,) * 4 + (2.61,) * 3,
        ),
    ),
)
