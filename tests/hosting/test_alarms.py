from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable

import pytest

from carecontact.hosting.alarms import Alarms


def soon(condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + 10.0
    while not condition() and time.monotonic() < until:
        time.sleep(0.005)
    return condition()


def test_each_rings_in_its_turn_and_a_cancelled_one_never() -> None:
    alarms, rang = Alarms(), list[str]()
    alarms.set(0.2, lambda: rang.append("later"))
    alarms.set(0.1, lambda: rang.append("cancelled")).cancel()
    alarms.set(0.05, lambda: rang.append("sooner"))
    assert soon(lambda: len(rang) == 2)
    assert rang == ["sooner", "later"]


def test_one_is_repeated_until_it_is_cancelled() -> None:
    alarms, rang = Alarms(), list[float]()
    alarm = alarms.set(0.02, lambda: rang.append(time.monotonic()), every_s=0.02)
    assert soon(lambda: len(rang) > 3)
    alarm.cancel()
    count = len(rang)
    time.sleep(0.1)
    assert len(rang) == count


def test_to_cancel_one_that_rings_waits_for_its_end() -> None:
    alarms, begun, ended = Alarms(), threading.Event(), threading.Event()
    alarm = alarms.set(0.0, lambda: (begun.set(), time.sleep(0.3), ended.set()))
    assert begun.wait(10.0)
    alarm.cancel()
    assert ended.is_set()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_function_that_raises_does_not_end_the_others() -> None:
    alarms, rang = Alarms(), threading.Event()
    alarms.set(0.0, lambda: 1 // 0)
    alarms.set(0.1, rang.set)
    assert rang.wait(10.0)


def test_one_is_set_where_no_further_thread_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    alarms, rang = Alarms(), threading.Event()
    alarms.start()
    monkeypatch.setattr(threading.Thread, "start", refused)
    alarms.set(0.01, rang.set)
    assert soon(rang.is_set)
    with pytest.raises(RuntimeError, match="can't start new thread"):
        Alarms().set(0.0, rang.set)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_has_a_thread_of_its_own() -> None:
    alarms = Alarms()
    alarms.set(60.0, lambda: None)
    child = os.fork()
    if child == 0:
        rang = threading.Event()
        alarms.set(0.01, rang.set)
        os._exit(0 if rang.wait(10.0) else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
