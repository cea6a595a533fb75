"""Actions that a policy may return, and their limits; one file per action space."""

from carecontact.contract.action.action import ACTION_SPACES, MAX_CHUNK, Action
from carecontact.contract.action.cartesian_pose import ActionBounds, check_action, clip_action

__all__ = ["ACTION_SPACES", "MAX_CHUNK", "Action", "ActionBounds", "check_action", "clip_action"]
