"""The robot with its tool, and the impedance that is part of the model: Cartesian, or of the joints.

Names: those of ``interface.robot.Robot``, for a baked arm also the bodies ``robot_link1``, ``robot_link2`` and so on;
mocap body ``tcp_target``; actuators ``impedance_0`` .. ``impedance_5`` (x y z, then rotation about x y z).

Visual geoms are in group 1 and never collide. Collision geoms are in group 3 with contype 1 and conaffinity 0: the
robot meets whatever has bit 1 in its conaffinity, and never itself.
"""

from __future__ import annotations

import json
from functools import lru_cache
from hashlib import sha256
from io import BytesIO
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import AssetError, SceneError
from carecontact.interface.robot import Baked, JointImpedance, Mjcf, Robot, Tip
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Impedance

FINGER_ORIGIN_Z_M = 0.0584
"""Height of the fingers' carriage in the hand's frame (joint finger_joint1 of the hand's URDF)."""
JOINT_DAMPING = 1.0
"""[N m s/rad] light viscous friction; assumed."""
JOINT_ARMATURE = 0.1
"""[kg m^2] reflected rotor inertia of the harmonic drives; assumed, the value commonly used for this arm."""
STICKS = (0.99, 0.99, 0.001, 0.5, 2.0)
"""MuJoCo's impedance of dry friction (solimpfriction). A joint that sticks creeps with a hundredth of its friction over
its inertia for every 10 ms; at the default of 0.9, with a tenth."""
GIVING_SOLREF, GIVING_SOLIMP = (-15_000.0, -20.0), (0.2, 0.2, 0.001, 0.5, 2.0)
"""MuJoCo's parameters of the contact between a tip that gives way and rigid surfaces. With a plate of the person
(``human.hulls``), 0.1 to 0.2 kg, the contact is a spring of 3 to 8 N/mm. Pile and foam of the mitt, as independent
springs under an ellipsoid on a plane, have 2.5 N/mm at 4 N and 6 N/mm at 25 N. MuJoCo scales a contact with the
colliding mass: on bone without a plate it is stiffer.

A stiff contact would rattle where it glides (``human.hulls.RIGID_TOOL_SOLIMP``). Here, what friction adds at
100 mm/s amounts to less than 0.5 N on a plate."""
GIVING_FRICTION = (0.5, 0.005, 0.0001)
"""That of the person's hulls."""
COLOURS = {
    "white": (0.93, 0.94, 0.95, 1.0),
    "grey": (0.80, 0.82, 0.84, 1.0),
    "dark": (0.16, 0.16, 0.17, 1.0),
    "blue": (0.04, 0.54, 0.78, 1.0),
}
CAP_COLOUR, MITT_COLOUR = (0.22, 0.24, 0.28, 1.0), (0.30, 0.47, 0.62, 1.0)
PEDESTAL_COLOUR = (0.45, 0.47, 0.50, 1.0)
PEDESTAL_RADIUS_M = 0.09
VISUAL_GROUP, COLLISION_GROUP = 1, 3
VISUAL = {"group": VISUAL_GROUP, "contype": 0, "conaffinity": 0}
COLLIDING = {"contype": 1, "conaffinity": 0}
HIDDEN = {"group": COLLISION_GROUP, "rgba": [0.8, 0.4, 0.2, 0.4]}
MESH = mujoco.mjtGeom.mjGEOM_MESH

Array = npt.NDArray[np.float64]


@lru_cache(maxsize=1)
def arrays_of(arm: Baked) -> dict[str, npt.NDArray[np.generic]]:
    """Return the arrays of a baked arm. Raises AssetError for a missing file or one without its stated hash."""
    name = arm.name
    try:
        data = arm.file().read_bytes()
        expected = json.loads(arm.file("provenance.json").read_text())["sha256"]
    except OSError as error:
        raise AssetError(f"robot asset {name}: {error}; reinstall the package or run tools/bake_{name}.py") from None
    if sha256(data).hexdigest() != expected:
        raise AssetError(f"robot asset {name}.npz does not match the sha256 in {name}.provenance.json")
    with np.load(BytesIO(data)) as archive:
        return {key: archive[key] for key in archive.files}


def damping_of(stiffness: float, inertia: float) -> float:
    """Return the critical damping 2 sqrt(K m) of one axis of the impedance."""
    return 2.0 * float(np.sqrt(stiffness * inertia))


def add_robot(spec: mujoco.MjSpec, protocol: Protocol) -> None:
    """Add the arm on its pedestal, the mocap target and the impedance actuators to ``spec``.

    The joints' neutral position is 0, which may be outside a joint's range: set the parked posture of the protocol
    before the first step. Torque limits apply to the impedance's torque, which is added to the gravity compensation.
    Raises SceneError if the base is under the floor.
    """
    scene = protocol.scene
    if scene.robot_base_m[2] <= 0:
        raise SceneError(f"scene.robot_base_m {list(scene.robot_base_m)}: the base must be above the floor")
    half_yaw = np.deg2rad(scene.robot_yaw_deg) / 2
    place = {"pos": scene.robot_base_m, "quat": [np.cos(half_yaw), 0.0, 0.0, np.sin(half_yaw)]}
    robot, source = scene.robot, scene.robot.source
    base = _attach(spec, robot, source, place) if isinstance(source, Mjcf) else _add_baked(spec, robot, source, place)
    if protocol.arm_errors is not None:
        for name, torque in zip(robot.joints, protocol.arm_errors.joint_friction_nm(robot), strict=False):
            joint = spec.joint(name)
            joint.frictionloss, joint.solimp_friction = torque, STICKS
    _add_pedestal(base, scene.robot_base_m[2])
    _add_impedance(spec, robot, protocol.impedance)


def _add_baked(spec: mujoco.MjSpec, robot: Robot, source: Baked, place: dict[str, Any]) -> mujoco.MjsBody:
    asset = arrays_of(source)
    meshes = _add_meshes(spec, asset)
    # A spec reads joint ranges in the angle unit of its compiler, by default degrees.
    to_spec_angle = np.rad2deg(1.0) if spec.compiler.degree else 1.0
    body = base = spec.worldbody.add_body(name=robot.base_body, gravcomp=1, **place)
    _set_inertial(body, asset, 0)
    _add_link_geoms(body, "link0", meshes)
    count = len(robot.joints)
    for i, joint in enumerate(robot.joints):
        name = f"link{i + 1}"
        body = body.add_body(
            name=f"robot_{name}", pos=asset["frame_position_m"][i], quat=asset["frame_quat"][i], gravcomp=1
        )
        effort = float(asset["joint_effort_nm"][i])
        body.add_joint(
            name=joint,
            axis=[0, 0, 1],
            range=np.asarray(asset["joint_range_rad"][i]) * to_spec_angle,
            limited=True,
            damping=[JOINT_DAMPING, 0, 0],
            armature=JOINT_ARMATURE,
            actfrclimited=True,
            actfrcrange=[-effort, effort],
        )
        _set_inertial(body, asset, i + 1)
        _add_link_geoms(body, name, meshes)
    hand = body.add_body(
        name=robot.flange_body, pos=asset["frame_position_m"][count], quat=asset["frame_quat"][count], gravcomp=1
    )
    _set_inertial(hand, asset, count + 1)
    _add_link_geoms(hand, "hand", meshes)
    _add_tool(spec, hand, meshes, robot)
    return base


def _attach(spec: mujoco.MjSpec, robot: Robot, source: Mjcf, place: dict[str, Any]) -> mujoco.MjsBody:
    """Add the arm of an MJCF text, weightless, without its actuators, in this module's groups and contact bits."""
    arm = mujoco.MjSpec.from_string(source.text, assets=dict(source.files))
    for row in [*arm.actuators, *arm.sensors, *arm.keys]:
        arm.delete(row)
    first = arm.body(robot.base_body.removeprefix(source.PREFIX))
    base = spec.worldbody.add_frame(**place).attach_body(first, source.PREFIX, "")
    for body in [base, *base.find_all("body")]:
        body.gravcomp = 1
    for geom in base.find_all("geom"):
        if geom.contype or geom.conaffinity:
            hidden = geom.group >= COLLISION_GROUP
            geom.contype, geom.conaffinity, geom.group = 1, 0, COLLISION_GROUP if hidden else VISUAL_GROUP
        else:
            geom.group = VISUAL_GROUP
    make_giving(spec, spec.geom(robot.tip.geom), robot.tip)
    return base


def make_giving(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, tip: Tip) -> None:
    """Let a tip's surface give way if the robot's does: to skin through the geom's first user number, where the
    compiled tissue reads it, and to everything rigid through the geom's own contact.
    """
    if tip.give_m3_n:
        spec.nuser_geom, geom.userdata = max(spec.nuser_geom, 1), [tip.give_m3_n]
        geom.solref, geom.solimp, geom.friction = GIVING_SOLREF, GIVING_SOLIMP, GIVING_FRICTION
        # The priority of the person's hulls. Among equals, the smaller solref and the larger friction count, and the
        # weight solmix decides about solimp.
        geom.priority, geom.solmix = 1, 1e6


def _add_meshes(spec: mujoco.MjSpec, asset: dict[str, npt.NDArray[np.generic]]) -> list[str]:
    """Add the meshes and return their names, ``robot_<visual|collision>_<link>_<colour or number>``."""
    names: list[str] = []
    for key in asset:
        if not key.endswith("/faces"):
            continue
        stem = key.removesuffix("/faces")
        name = "robot_" + stem.replace("/", "_")
        mesh = spec.add_mesh(name=name)
        mesh.uservert = np.asarray(asset[f"{stem}/vertices"], np.float64).ravel()
        mesh.userface = np.asarray(asset[key], np.int32).ravel()
        # Visual meshes are open surfaces; links have explicit inertias, so that a mesh's own inertia is never used.
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        names.append(name)
    return names


def _set_inertial(body: mujoco.MjsBody, asset: dict[str, npt.NDArray[np.generic]], row: int) -> None:
    body.mass = float(asset["mass_kg"][row])
    body.ipos = asset["centre_of_mass_m"][row]
    body.fullinertia = asset["inertia_kgm2"][row]
    body.explicitinertial = True


def _add_link_geoms(body: mujoco.MjsBody, link: str, meshes: list[str]) -> None:
    for name in meshes:
        _, kind, of_link, part = name.split("_")
        if of_link == link:
            look = VISUAL | {"rgba": COLOURS[part]} if kind == "visual" else COLLIDING | HIDDEN
            body.add_geom(name=name, type=MESH, meshname=name, **look)


def _add_pedestal(base: mujoco.MjsBody, height_m: float) -> None:
    look, (cylinder, box) = (
        VISUAL | {"rgba": PEDESTAL_COLOUR},
        (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX),
    )
    column = [-0.03, 0, -height_m, -0.03, 0, -0.02]
    base.add_geom(name="robot_pedestal", type=cylinder, fromto=column, size=[PEDESTAL_RADIUS_M, 0, 0], **look)
    base.add_geom(name="robot_pedestal_plate", type=box, pos=[-0.04, 0, -0.01], size=[0.125, 0.10, 0.01], **look)


def _add_tool(spec: mujoco.MjSpec, hand: mujoco.MjsBody, meshes: list[str], robot: Robot) -> None:
    """Add the closed fingers (visual), the shaft that collides for them, the tip, and the tool centre point."""
    tip = robot.tip
    for name in meshes:
        _, kind, link, part = name.split("_")
        if link == "finger" and kind == "visual":
            finger = {"meshname": name, "pos": [0, 0, FINGER_ORIGIN_Z_M], "rgba": COLOURS[part]} | VISUAL
            for suffix, quat in (("", [1, 0, 0, 0]), ("_turned", [0, 0, 0, 1])):
                hand.add_geom(name=name + suffix, type=MESH, quat=quat, **finger)
    hand.add_geom(
        name="robot_finger_shaft",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0, 0, FINGER_ORIGIN_Z_M, 0, 0, robot.tip_centre_z_m - 0.01],
        size=[0.011, 0, 0],
        **COLLIDING,
        **HIDDEN,
    )
    touching = hand.add_geom(
        name=tip.geom,
        type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        pos=[0, 0, robot.tip_centre_z_m],
        size=tip.half_m,
        group=VISUAL_GROUP,
        rgba=MITT_COLOUR if tip.give_m3_n else CAP_COLOUR,
        **COLLIDING,
    )
    make_giving(spec, touching, tip)
    hand.add_site(name=robot.tcp_site, pos=[0, 0, robot.tcp_z_m], size=[0.003, 0.003, 0.003], group=4)


def _add_impedance(spec: mujoco.MjSpec, robot: Robot, impedance: Impedance) -> None:
    """Add six springs and dampers between ``tcp`` and the mocap target, each along or about one axis of the target.

    With a reference site, the transmission's length is the pose error in the target's frame, so that a position servo
    with the set point 0 is the spring. The mocap body has no velocity, so that damping acts relative to the world.
    """
    target = spec.worldbody.add_body(name="tcp_target", mocap=True)
    target.add_site(name="tcp_target", size=[0.003, 0.003, 0.003], group=4)
    for axis in range(6):
        linear = axis < 3
        stiffness = impedance.translational_n_m if linear else impedance.rotational_nm_rad
        inertia = impedance.effective_mass_kg if linear else impedance.effective_inertia_kgm2
        clamp = impedance.force_clamp_n if linear else impedance.torque_clamp_nm
        _add_servo(
            spec,
            stiffness,
            damping_of(stiffness, inertia),
            name=f"impedance_{axis}",
            trntype=mujoco.mjtTrn.mjTRN_SITE,
            target=robot.tcp_site,
            refsite="tcp_target",
            gear=np.eye(6)[axis],
            forcelimited=True,
            forcerange=[-clamp, clamp],
        )


AXES = 6


def servo(number: int) -> str:
    """Return the name of a joint's actuator; joints count from 0."""
    return f"joint_impedance_{number}"


def tendon(axis: int) -> str:
    """Return the name of an axis' tendon and of its actuator; axes count from 0."""
    return f"flange_impedance_{axis}"


def replace_impedance(spec: mujoco.MjSpec, robot: Robot, law: JointImpedance) -> None:
    """Replace the Cartesian impedance of a world with a robot, before it is compiled, by a joint impedance.

    One servo acts on each joint. Six act on tendons whose coefficients are the rows of the flange's Jacobian: a
    tendon's length is then ``J q``, its velocity ``J qdot``, and the torque of a servo with the set point ``J q_d`` is
    ``J^T (Kx J (q_d - q) - Kxd J qdot)``. ``sim.controllers.JointControl`` keeps the coefficients current.

    Raises SceneError for gains of a robot with another number of joints.
    """
    if (count := len(law.stiffness_nm_rad)) != len(robot.joints):
        raise SceneError(f"robot {robot.id} has {len(robot.joints)} joints, and the control has gains of {count}")
    for axis in range(AXES):
        spec.delete(spec.actuator(f"impedance_{axis}"))
    for number, (name, k, d, limit) in enumerate(
        zip(robot.joints, law.stiffness_nm_rad, law.damping_nms_rad, law.torque_limit_nm, strict=True)
    ):
        _add_servo(spec, k, d, name=servo(number), trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        spec.joint(name).actfrcrange = [-limit, limit]
    for axis, (k, d) in enumerate(zip(law.cartesian_stiffness, law.cartesian_damping, strict=True)):
        row = spec.add_tendon(name=tendon(axis))
        for name in robot.joints:
            # The compiler refuses a coefficient of 0; the first refresh writes the real one.
            row.wrap_joint(name, 1.0)
        _add_servo(spec, k, d, name=tendon(axis), trntype=mujoco.mjtTrn.mjTRN_TENDON, target=tendon(axis))


def _add_servo(spec: mujoco.MjSpec, stiffness: float, damping: float, **transmission: Any) -> None:
    """Add a position servo with a damper."""
    fixed, affine = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    actuator = spec.add_actuator(gaintype=fixed, biastype=affine, **transmission)
    actuator.gainprm[0] = stiffness
    actuator.biasprm[:3] = [0.0, -stiffness, -damping]
