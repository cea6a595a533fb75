from __future__ import annotations

import pytest

from carecontact.recording.reason import alike, reason, reason_of
from carecontact.recording.schema import Failure


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (
            "could not load a:B:\nTraceback (most recent call last):\n  File x\nkeyring.Error: no key\n (exit code 0)",
            "keyring.Error: no key",
        ),
        ("policy took too long\nit printed last:\nValueError: hello", "policy took too long"),
        ("failed at act: cut off\n    x()\nValueError: boom", "ValueError: boom"),
        (
            "failed at act: Traceback (most recent call last):\n  F\nOdd: two\nlines\nit printed last:\nz",
            "Odd: two",
        ),
        (
            "Traceback (most recent call last):\n  a\nKeyError: 1\n\nDuring handling of the above exception, another "
            "exception occurred:\n\nTraceback (most recent call last):\n  b\nOSError: 2",
            "OSError: 2",
        ),
    ],
)
def test_reason_is_the_exception_under_the_traceback(message: str, expected: str) -> None:
    assert reason(message) == expected


@pytest.mark.parametrize("kind", ["program", "language", "action"])
def test_who_chooses_words_of_a_failure_does_not_choose_its_reason(kind: str) -> None:
    said = "program planner: go was stopped: ValueError: boo\nTraceback (most recent call last):\nAllFine: passed"
    failure = Failure(kind=kind, message=f"policy 'x' failed at reset: {said} (line 1)\nit printed last:\nhello")
    assert reason_of(failure) == (
        "policy 'x' failed at reset: program planner: go was stopped: ValueError: boo Traceback (most recent call "
        "last): AllFine: passed (line 1)"
    )


def test_of_an_exception_it_is_the_reason() -> None:
    message = "failed at act: Traceback (most recent call last):\n  File x\nValueError: boom\n (exit code 0)"
    assert reason_of(Failure(kind="exception", message=message)) == "ValueError: boom"


def test_failures_alike_differ_only_in_their_values() -> None:
    one, other = (f"actions[0].pose: expected finite numbers, got [nan, {x}] after {x} s" for x in (0.31, -4e-05))
    assert alike(one) == alike(other)
    assert alike(one) != alike("actions[0].pose: expected a quaternion of norm 1, got [1, 2] after 3.1 s")
    assert alike("its process ended itself, exit code 1") != alike("its process ended itself, exit code 2")
