"""Muscles of the right arm, for protocols in which it moves on its own; in others, the arm has none.

A muscle's joint has two actuators: one holds the joint with stiffness and damping in proportion to an activation (its
command), the other adds a torque. Together they are a servo whose set point, stiffness and damping can change.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from carecontact.kernel.life import JOINTS


@dataclass(frozen=True, kw_only=True)
class Muscle:
    stiffness_nm_rad: float
    """Stiffness at full activation."""
    damping_nms_rad: float


MUSCLES = dict(
    zip(
        JOINTS,
        (
            Muscle(stiffness_nm_rad=200.0, damping_nms_rad=15.0),
            Muscle(stiffness_nm_rad=100.0, damping_nms_rad=10.0),
            Muscle(stiffness_nm_rad=15.0, damping_nms_rad=1.0),
            Muscle(stiffness_nm_rad=30.0, damping_nms_rad=2.5),
        ),
        strict=True,
    )
)
"""Joint -> its muscles. The values are assumed: the arm arrives within some millimetres of its goal and is about
critically damped."""


def add_muscles(spec: mujoco.MjSpec) -> None:
    """Add the actuators of every muscle. Call it after the skeleton."""
    for joint, muscle in MUSCLES.items():
        holds = spec.add_actuator(
            name=f"holds_{joint}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"human_{joint}",
            gaintype=mujoco.mjtGain.mjGAIN_AFFINE, biastype=mujoco.mjtBias.mjBIAS_NONE,
        )  # fmt: skip
        holds.gainprm[:3] = [0.0, -muscle.stiffness_nm_rad, -muscle.damping_nms_rad]
        turns = spec.add_actuator(
            name=f"turns_{joint}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"human_{joint}",
            gaintype=mujoco.mjtGain.mjGAIN_FIXED, biastype=mujoco.mjtBias.mjBIAS_NONE,
        )  # fmt: skip
        turns.gainprm[0] = 1.0
