from __future__ import annotations

import errno

import pytest

from carecontact.errors import ConfigError, ExhaustedError
from carecontact.exhausted import is_exhausted


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), True),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), True),
        (RuntimeError("can't start new thread"), True),
        (MemoryError(), True),
        (ExhaustedError("no process"), True),
        (RuntimeError("dictionary changed size"), False),
        (FileNotFoundError(errno.ENOENT, "No such file"), False),
        (ConfigError("wrong"), False),
    ],
)
def test_what_says_that_something_is_used_up(error: Exception, expected: bool) -> None:
    assert is_exhausted(error) == expected
    later = ValueError("of that")
    later.__context__ = error
    assert is_exhausted(later) == expected
