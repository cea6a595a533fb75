"""Normalised joint velocities as DROID's robots execute them."""

from __future__ import annotations

from carecontact.contract.action.action import Action
from carecontact.contract.action.space import ACTION_SPACES, ActionSpace, check_gripper
from carecontact.contract.action.spaces.joint_position import joints_of
from carecontact.contract.session import Session


def _check(action: Action, session: Session) -> Action:
    joint = None if action.joint is None else joints_of(action, session, "1 is 0.2 rad in one control period")
    return Action(joint=joint, gripper=check_gripper(action.gripper), done=bool(action.done))


ACTION_SPACES.register(
    "droid_joint_velocity",
    ActionSpace(
        description=(
            "Seven normalised joint velocities. At each action the target becomes the measured angles plus 0.2 rad "
            "times the velocities, scaled down if one exceeds 1, and is held until the next action."
        ),
        fields=("joint",),
        in_joints=True,
        checked=_check,
        clipped=lambda action, session: action,
        driver="carecontact.episode.drivers.joint:DroidJointVelocity",
    ),
)
