"""Replaces the Cartesian impedance by a joint impedance, made of servos in the compiled model.

One servo acts on each joint. Six act on tendons whose coefficients are the rows of the flange's Jacobian: a
tendon's length is then ``J q``, its velocity ``J qdot``, and the torque of a servo with the set point ``J q_d`` is
``J^T (Kx J (q_d - q) - Kxd J qdot)``. ``sim.joint_control`` keeps the coefficients current.
"""

from __future__ import annotations

import mujoco

from carecontact.contract.control import JointImpedance
from carecontact.contract.embodiment import Robot
from carecontact.errors import SceneError

AXES = 6


def servo(number: int) -> str:
    """Return the name of a joint's actuator; joints count from 0."""
    return f"joint_impedance_{number}"


def tendon(axis: int) -> str:
    """Return the name of an axis' tendon and of its actuator; axes count from 0."""
    return f"flange_impedance_{axis}"


def replace_impedance(spec: mujoco.MjSpec, robot: Robot, law: JointImpedance) -> None:
    """Replace the Cartesian impedance of a world with a robot, before it is compiled, by a joint impedance. Raises
    SceneError for gains of a robot with another number of joints.
    """
    if (count := len(law.stiffness_nm_rad)) != len(robot.joints):
        raise SceneError(f"robot {robot.id} has {len(robot.joints)} joints, and the control has gains of {count}")
    for axis in range(AXES):
        spec.delete(spec.actuator(f"impedance_{axis}"))
    for number, (name, k, d, limit) in enumerate(
        zip(robot.joints, law.stiffness_nm_rad, law.damping_nms_rad, law.torque_limit_nm, strict=True)
    ):
        _add_servo(spec, servo(number), mujoco.mjtTrn.mjTRN_JOINT, name, k, d)
        spec.joint(name).actfrcrange = [-limit, limit]
    for axis, (k, d) in enumerate(zip(law.cartesian_stiffness, law.cartesian_damping, strict=True)):
        row = spec.add_tendon(name=tendon(axis))
        for name in robot.joints:
            # The compiler refuses a coefficient of 0; the first refresh writes the real one.
            row.wrap_joint(name, 1.0)
        _add_servo(spec, tendon(axis), mujoco.mjtTrn.mjTRN_TENDON, tendon(axis), k, d)


def _add_servo(
    spec: mujoco.MjSpec, name: str, kind: mujoco.mjtTrn, target: str, stiffness: float, damping: float
) -> None:
    actuator = spec.add_actuator(
        name=name, trntype=kind, target=target, gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
    )  # fmt: skip
    actuator.gainprm[0] = stiffness
    actuator.biasprm[:3] = [0.0, -stiffness, -damping]
