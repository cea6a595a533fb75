from __future__ import annotations

import threading
import time

import pytest

from carecontact.policies.language.deadline import call_within


def test_what_is_in_time_is_returned_or_raised() -> None:
    assert call_within(5, lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        call_within(5, lambda: 1 // 0)


def test_what_is_late_is_left_to_itself() -> None:
    held = threading.Event()
    began = time.monotonic()
    with pytest.raises(TimeoutError):
        call_within(0.05, held.wait)
    assert time.monotonic() - began < 1
    held.set()


def test_what_is_late_already_is_not_begun() -> None:
    begun = list[int]()
    with pytest.raises(TimeoutError):
        call_within(0, lambda: begun.append(1))
    assert not begun
