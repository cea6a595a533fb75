"""An action that is at fault is named with its method and the trial; whatever is asked of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carecontact.behaviours.touch import Touch
from carecontact.contract.protocol import BEHAVIOURS
from carecontact.errors import ConfigError, RecordingError
from carecontact.scoring import score_recording
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
        f"action 'touch': {method} failed in trial T1-s000: ZeroDivisionError: by zero (test_ask.py, line "
    )


@pytest.mark.parametrize(
    ("method", "answer", "told"),
    [
        ("judge", None, "judge returned None in trial T1-s000; expected a Judgement"),
        ("holding", np.ones(3, bool), r"holding returned bool of shape \(3,\) in .*; expected an array of booleans"),
        ("holding", True, "holding returned True in trial T1-s000; expected an array of booleans"),
        ("passes", "yes", "passes returned 'yes' in trial T1-s000; expected True or False"),
    ],
)
def test_an_answer_that_is_none_is_named(method: str, answer: Any, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with_method(monkeypatch, method, answer)
    with pytest.raises(ConfigError, match=f"^action 'touch': {told}"):
        score_recording(touch())


def test_an_error_of_carecontact_keeps_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    with_method(monkeypatch, "judge", RecordingError("T1-s000: policy/notes/0 is malformed"))
    with pytest.raises(RecordingError, match=r"^T1-s000: policy/notes/0 is malformed$"):
        score_recording(touch())
