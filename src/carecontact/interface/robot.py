"""The robot as policies and protocols know it: its arm and hand, the controllers that may execute actions, and the
session, which a policy receives before its first observation."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from importlib.resources.abc import Traversable
from typing import ClassVar

from carecontact.errors import ConfigError
from carecontact.registry import Registry


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
class Baked:
    """An arm of this package in the format of ``tools/bake_panda.py``: frames, masses and meshes as arrays."""

    name: str

    def file(self, kind: str = "npz") -> Traversable:
        return resources.files("carecontact") / "assets" / self.name / f"{self.name}.{kind}"

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.file().read_bytes()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Mjcf:
    """An arm with its tool as MuJoCo's XML. The tree of ``Robot.base_body`` is taken from it, and nothing else.

    In the compiled model, each name begins with ``PREFIX``; a ``Robot`` has these names.
    """

    PREFIX: ClassVar[str] = "robot_"

    text: str
    files: Mapping[str, bytes] = field(default_factory=dict[str, bytes], hash=False)
    """The meshes and textures that the text names."""

    @property
    def sha256(self) -> str:
        return hashlib.sha256(repr((self.text, sorted(self.files.items()))).encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Dimensions by which a place of the base is refused before any posture is computed (``episode.base_placement``).
    They hold for a tool that points down."""

    shoulder_height_m: float
    """Height of the shoulder over the base."""
    wrist_offset_m: float
    """Horizontal distance from the wrist out to the tool's axis."""
    wrist_to_tcp_m: float
    """Height of the wrist over the tool centre point."""
    wrist_m: tuple[float, float]
    """Least and largest distance of the wrist from the shoulder."""
    moved_wrist_m: tuple[float, float]
    """The same after the person has moved the arm."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A robot with its tool. The compiled model, the policies and the recordings share it."""

    id: str
    """Its name in every recording and in the lock of every protocol."""
    source: Baked | Mjcf
    joints: tuple[str, ...]
    """Names in the compiled model, from the base to the tool; every joint is a hinge."""
    joint_low_rad: tuple[float, ...]
    joint_high_rad: tuple[float, ...]
    base_body: str
    """Body whose frame is the base frame."""
    flange_body: str
    """The last body. Its origin is the flange; tool and wrist camera are fixed to it."""
    tcp_site: str
    """Site at the tool centre point; its z axis points out of the tool."""
    tip: Tip
    tcp_z_m: float
    """Distance of the tool centre point, the tip's outermost point, from the flange along its z axis, out of the
    tool."""
    parked_joint_rad: tuple[float, ...]
    """Posture in which a trial begins unless its protocol gives another."""
    reach: Reach | None = None
    """None: no place of this robot's base can be drawn by a seed."""
    wrist_geoms: tuple[str, ...] = ()
    """How the names begin of the geoms that the oracle keeps clear of the person."""
    friction_nm: tuple[float, ...] = ()
    """(joints,) dry friction that the robot's own controller does not compensate [N m], which a protocol may let act
    (``protocol.sections.ArmErrors``); empty where it is not known."""
    hand_boxes_m: tuple[tuple[tuple[float, float, float], float], ...] = ()
    """Half sides, in the flange's axes, of boxes round fingers, hand and last links, and how far their middles are
    behind the tool centre point: what may hide a contact from a camera."""

    @property
    def tool_radius_m(self) -> float:
        """Half of the tip's smallest size."""
        return min(self.tip.half_m)

    @property
    def tip_centre_z_m(self) -> float:
        """Place of the tip's middle along the flange's z axis."""
        return self.tcp_z_m - self.tip.half_m[2]


EMBODIMENTS: Registry[Robot] = Registry("robot", row=Robot)
"""``scene.tool`` of a protocol -> the robot that has this tool."""


def robot_of(embodiment: str) -> Robot | None:
    """Return the robot that recordings name by an id; None for one that is not installed here."""
    return next((robot for robot in EMBODIMENTS.usable().values() if robot.id == embodiment), None)


PANDA = Robot(
    id="panda-closed-gripper-caps",
    source=Baked(name="panda"),
    joints=tuple(f"robot_joint{number}" for number in range(1, 8)),
    joint_low_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
    joint_high_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    base_body="robot_base",
    flange_body="robot_hand",
    tcp_site="tcp",
    tip=Tip(geom="robot_tool_cap", half_m=(0.012, 0.019, 0.012)),
    tcp_z_m=0.117,
    parked_joint_rad=(0.5324, -0.3907, 0.3589, -1.8387, 0.1348, 1.4716, 1.1415),
    # Lengths from the data sheet, as in policies.state_machine.fixed_values. The second range is the state machine's
    # comfortable one; the first is narrower, because what a policy sees is off by some millimetres.
    reach=Reach(
        shoulder_height_m=0.333,
        wrist_offset_m=0.088,
        wrist_to_tcp_m=0.107 + 0.117,
        wrist_m=(0.30, 0.695),
        moved_wrist_m=(0.26, 0.712),
    ),
    wrist_geoms=tuple(f"robot_collision_{link}_" for link in ("hand", "link7", "link6", "link5")),
    # phi_1 / 2 tanh(phi_2 w / 2), as identified by Gaz et al. (2019, IEEE Robot Autom Lett 4:4147; parameters in the
    # authors' repository marcocognetti/FrankaEmikaPandaDynModel, franka_model.h), at w = 0.15 rad/s: a joint turns so
    # fast while the tool scrubs with 0.07 m/s half a metre away. In the identified law friction fades as a joint comes
    # to rest; that it stays and lets the joint stick is assumed. At the tool this is 1 to 2 N.
    friction_nm=(0.1, 0.258, 0.205, 0.254, 0.233, 0.13, 0.184),
    # Measured on the meshes.
    hand_boxes_m=(((0.011, 0.026, 0.022), 0.036), ((0.032, 0.102, 0.041), 0.092), ((0.045, 0.060, 0.090), 0.210)),
)
"""Franka Emika Panda; joint limits as in the franka description package, from which the arm's meshes come too. The
hand is permanently closed: a cap covers the fingertips. The cap is an ellipsoid, because an ellipsoid has
no rims and no flat sides: the compiled tissue meets it in one point of each triangle, and the force does not jump where
skin slides over it."""

PILE_M3_N, FOAM_M3_N = 4e-7, 1e-7
"""[m/Pa] How far pile and foam of the wash mitt give way under pressure; docs/evidence/tissue.md has the sources.

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

EMBODIMENTS.register("caps", PANDA)
EMBODIMENTS.register("mitt", PANDA_MITT)


# The controllers that may execute a policy's actions, by the id that a card gives as ``control``.

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


@dataclass(frozen=True, kw_only=True)
class ActionBounds:
    """Limits that a policy learns before its first action."""

    workspace_low_m: tuple[float, float, float]
    workspace_high_m: tuple[float, float, float]
    """Box of TCP positions in base."""
    translational_stiffness: tuple[float, float]
    rotational_stiffness: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Compliance:
    """The Cartesian impedance as it is until an action changes it, and what damps it."""

    stiffness: tuple[float, float]
    """Translational [N/m] and rotational [N m/rad]."""
    damping_ratio: float
    """Share of critical damping: the damping of an axis is 2 * ratio * sqrt(stiffness * mass)."""
    effective_mass_kg: float
    """The mass in that formula for the translational axes."""
    effective_inertia_kgm2: float
    """The same for the rotational axes."""


@dataclass(frozen=True, kw_only=True)
class Session:
    """What holds for every trial of a protocol: limits, cameras and compliance. Carries no seed, task id or label."""

    action_bounds: ActionBounds
    joint_low_rad: tuple[float, ...]
    """(joints,) lower joint limits of the robot"""
    joint_high_rad: tuple[float, ...]
    """(joints,)"""
    camera_sizes_px: dict[str, tuple[int, int]]
    """Camera -> (width, height) [px], for every camera of the scene, whether the card requests it or not."""
    time_limit_s: float
    compliance: Compliance | None = None
    """None under a joint control, whose gains are those of its row in CONTROLS."""
    force_bias_n: float = 0.0
    """Standard deviation, along each axis, of a constant force at the tool that the arm exerts beside what is
    commanded; 0: the arm is ideal."""
    joint_friction_nm: tuple[float, ...] = ()
    """(joints,) dry friction [N m] that the controller does not compensate; empty: the arm is ideal"""
