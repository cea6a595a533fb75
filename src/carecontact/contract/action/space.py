"""What an action space is: the fields that its actions may give, and their check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from carecontact.contract.action.action import Action
from carecontact.contract.action.hints import gripper_hint
from carecontact.contract.session import Session
from carecontact.errors import ActionError
from carecontact.registry import Registry

EVERY_SPACE = ("gripper", "done")
"""Fields of an action that belong to no space."""


@dataclass(frozen=True, kw_only=True)
class ActionSpace:
    """A row of ACTION_SPACES. The registered name is what a policy's card gives as ``action_space``."""

    description: str
    fields: tuple[str, ...]
    """Fields of ``Action`` that belong to this space, besides EVERY_SPACE; the others must be None."""
    in_joints: bool
    """Whether the actions are commands of a joint controller, which the card then has to name as its ``control``."""
    checked: Callable[[Action, Session], Action]
    """The action in normal form; raises ActionError naming the field, what was expected and what was got."""
    clipped: Callable[[Action, Session], Action]
    """The action moved into the bounds; the same object where nothing is outside, or where ``checked`` refuses it."""
    driver: str
    """``module:Class`` of the ``episode.drivers.Driver`` that turns checked actions into commands."""

    def check(self, action: Action, session: Session) -> Action:
        """Return the action in normal form. Raises ActionError naming the field, what was expected and what was got."""
        for field in fields(Action):
            if field.name in self.fields or field.name in EVERY_SPACE or getattr(action, field.name) is None:
                continue
            raise ActionError(
                f"{field.name}: this field is not one of the card's action space; give {', '.join(self.fields)}, or "
                "another action_space on the card"
            )
        return self.checked(action, session)

    def clip(self, action: Action, session: Session) -> Action:
        """Return the action moved into the bounds, for a card whose ``out_of_bounds`` is ``clip``; the same object if
        nothing has to be moved."""
        return self.clipped(action, session)


ACTION_SPACES: Registry[ActionSpace] = Registry(
    "action space", row=ActionSpace, plural="action_spaces", scan="carecontact.contract.action.spaces"
)


def check_gripper(opening: float | None) -> float | None:
    """Raises ActionError for an opening outside [0, 1]."""
    if opening is not None and not 0 <= opening <= 1:
        raise ActionError(f"gripper: expected an opening in [0, 1], got {opening}{gripper_hint(opening)}")
    return opening
