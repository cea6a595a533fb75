"""An action space, a control and a policy that uses both: steps of the joints from their last target.

The driver has a module of its own, because the policy's process, which loads the space, may import no simulation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from carecontact.errors import ActionError
from carecontact.interface.action import ACTION_SPACES, Action, ActionSpace
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Control, JointImpedance, Session

LARGEST_RAD = 0.05


def _check(action: Action, session: Session) -> Action:
    checked = ACTION_SPACES["droid_joint_velocity"].check(action, session)
    if checked.joint is not None and np.abs(checked.joint).max() > LARGEST_RAD:
        raise ActionError(f"joint: expected steps of at most {LARGEST_RAD:g} rad, got {checked.joint.tolist()}")
    return checked


def _clip(action: Action, session: Session) -> Action:
    if action.joint is None:
        return action
    inside = np.clip(action.joint, -LARGEST_RAD, LARGEST_RAD)
    return action if (inside == action.joint).all() else replace(action, joint=inside)


JOINT_STEP = ActionSpace(
    description="Steps of the seven joints [rad] from their last target.",
    fields=("joint",),
    in_joints=True,
    checked=_check,
    clipped=_clip,
    driver="outside_step_driver:JointStep",
)
SOFT_JOINTS = Control(
    description="Soft joints of a package from outside.",
    joint=JointImpedance(
        stiffness_nm_rad=(60.0,) * 7,
        damping_nms_rad=(8.0,) * 7,
        torque_limit_nm=(40.0,) * 4 + (10.0,) * 3,
        velocity_limit_rad_s=(1.0,) * 7,
    ),
)


class Step:
    card = PolicyCard(name="step", action_space="joint_step", control="soft-joints", cameras=(), control_hz=10)

    def reset(self, instruction: str) -> None:
        pass

    def act(self, observation: object) -> list[Action]:
        return [Action(joint=np.array([0, 0, 0, 0, 0, 0, 0.02]))] * 9 + [Action(done=True)]

    def configure(self, session: Session) -> Mapping[str, object]:
        return {}
