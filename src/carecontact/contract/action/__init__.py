"""Actions that a policy may return, and the spaces that say which of their fields it may give."""

from carecontact.contract.action.action import MAX_CHUNK, Action
from carecontact.contract.action.space import ACTION_SPACES, ActionSpace
from carecontact.contract.action.spaces.cartesian_pose import check_action, clip_action

__all__ = ["ACTION_SPACES", "MAX_CHUNK", "Action", "ActionSpace", "check_action", "clip_action"]
