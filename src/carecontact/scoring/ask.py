"""Calls a method of an action's Behaviour on a trial. If the method fails or returns a wrong type, the error names the
action and the trial."""

from __future__ import annotations

from typing import Any

import numpy as np

from carecontact.contract.protocol import BEHAVIOURS
from carecontact.errors import ConfigError
from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.blame import blamed_on, shown
from carecontact.scoring.contact import Contact
from carecontact.scoring.gate import Judgement

ANSWERS: dict[str, tuple[tuple[Any, ...], str]] = {
    "holding": ((np.ndarray,), "an array of booleans, one for each physics step"),
    "judge": ((Judgement,), "a Judgement"),
    "lost": ((bool, np.bool_), "True or False"),
    "passes": ((bool, np.bool_), "True or False"),
    "requested": ((str, type(None)), "a text or None"),
    "parts": ((list,), "a list of GatePart"),
    "shortfall": ((str,), "a text"),
}
"""Method of a Behaviour -> classes of its answer, and the same in words."""


def ask(contact: Contact, method: str, *arguments: object, action: str | None = None) -> Any:
    """Return what a method of a behaviour answers; ANSWERS says of which class that is.

    Args:
        contact: of the trial that is judged.
        action: whose behaviour; default: that of the trial's task.

    Raises ConfigError naming the action, its package and the trial if the method raises or answers otherwise.
    """
    action = action or contact.task.action
    trial_id = contact.recording.header.spec.trial_id
    behaviour = behaviour_of(action, contact.protocol.gates.set)
    title = f"{BEHAVIOURS.title(action)}: {method}"
    with blamed_on(title, trial_id):
        found: Any = getattr(behaviour, method)(*arguments)
    classes, expected = ANSWERS[method]
    if not isinstance(found, classes):
        raise ConfigError(f"{title} returned {shown(found)} in trial {trial_id}; expected {expected}")
    shape = contact.neighbourhood_on.shape
    if method == "holding" and (found.shape != shape or found.dtype != np.bool_):
        answer = f"{found.dtype} of shape {found.shape}"
        raise ConfigError(f"{title} returned {answer} in trial {trial_id}; expected {expected}, shape {shape}")
    return found
