from __future__ import annotations

import pytest

from carecontact.hosting.wire.tracebacks import TRACEBACK_CHARS, told


@pytest.mark.parametrize(("said", "kept"), [("short", "\nValueError: short\n"), ("x" * 5000, "xxx [...]")])
def test_of_a_long_traceback_the_end_of_the_stack_and_the_start_of_the_message_are_kept(said: str, kept: str) -> None:
    error: BaseException = ValueError(said)
    error.__cause__ = RuntimeError("earlier\n" * 1000 + "last frame")
    text = told(error)
    assert len(text) == TRACEBACK_CHARS
    assert text.endswith(kept)
    assert text.index("last frame") < text.index("ValueError: ") >= TRACEBACK_CHARS / 2 - len(kept)
