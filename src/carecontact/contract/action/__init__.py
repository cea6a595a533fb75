"""What a policy may answer, and the limits that hold for it: one file an action space."""

from carecontact.contract.action.action import ACTION_SPACES, MAX_CHUNK, Action
from carecontact.contract.action.cartesian_pose import ActionBounds, check_action, clip_action

__all__ = ["ACTION_SPACES", "MAX_CHUNK", "Action", "ActionBounds", "check_action", "clip_action"]
