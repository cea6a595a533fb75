"""An action that is at fault is named with its method and the trial; whatever is asked of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carecontact.errors import ConfigError, RecordingError
from carecontact.scoring import score_recording
from carecontact.scoring.actions import Touch
from carecontact.scoring.behaviour import BEHAVIOURS
from tests.scoring.synthetic import hold, make_recording, touch


def with_method(monkeypatch: pytest.MonkeyPatch, method: str, answer: Any) -> None:
    """Replace a method of the action ``touch``; an exception is raised, everything else returned."""

    def replaced(self: Touch, *arguments: object) -> Any:
        if isinstance(answer, Exception):
            raise answer
        return answer

    broken = type("Broken", (Touch,), {method: replaced})()
    monkeypatch.setitem(BEHAVIOURS._rows, "touch", broken)


@pytest.mark.parametrize("method", ["holding", "judge", "passes", "lost", "requested", "shortfall"])
def test_a_method_that_raises_is_named(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with_method(monkeypatch, method, ZeroDivisionError("by\nzero"))
    short = {"right_forearm": hold(3.0, 2.6, 3.0, 5.0)}
    recording = make_recording("T1", normal=short, targets_in_region=[(0.4, (0.0, 0.0, 0.0))])
    with pytest.raises(ConfigError) as caught:
        score_recording(recording)
    assert str(caught.value).startswith(
        f"action 'touch': {method} failed in trial T1-s000: ZeroDivisionError: by zero (test_behaviour.py, line "
    )


@pytest.mark.parametrize(
    ("method", "answer", "message"),
    [
        ("judge", None, "judge returned None in trial T1-s000; expected a Judgement"),
        ("holding", np.ones(3, bool), r"holding returned bool of shape \(3,\) in .*; expected an array of booleans"),
        ("holding", True, "holding returned True in trial T1-s000; expected an array of booleans"),
        ("passes", "yes", "passes returned 'yes' in trial T1-s000; expected True or False"),
    ],
)
def test_an_answer_that_is_none_is_named(
    method: str, answer: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_method(monkeypatch, method, answer)
    with pytest.raises(ConfigError, match=f"^action 'touch': {message}"):
        score_recording(touch())


def test_an_error_of_carecontact_keeps_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    with_method(monkeypatch, "judge", RecordingError("T1-s000: policy/notes/0 is malformed"))
    with pytest.raises(RecordingError, match=r"^T1-s000: policy/notes/0 is malformed$"):
        score_recording(touch())


# The name on the card of a policy that is reached by its address.


@pytest.mark.parametrize(
    ("policy", "name", "title"),
    [
        ("ws://192.0.2.7:8765", "my-vla 3", "my-vla 3 at ws://192.0.2.7:8765"),
        ("mine:Mine", None, "mine:Mine"),
    ],
)
def test_an_address_is_shown_with_the_name_of_what_answers_there(policy: str, name: str | None, title: str) -> None:
    made = touch()
    spec = made.header.spec.model_copy(update={"policy": policy})
    card = {**(made.header.card or {}), "name": "my-vla 3"}
    object.__setattr__(made, "header", made.header.model_copy(update={"spec": spec, "card": card}))
    score = score_recording(made)
    assert (score.policy_name, score.policy_title) == (name, title)
