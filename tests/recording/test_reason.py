from __future__ import annotations

import pytest

from carecontact.recording.reason import reason


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
