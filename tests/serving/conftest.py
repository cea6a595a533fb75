from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from carecontact.interface.policy import PolicyRef
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import PolicyProcess

PREAMBLE = """
import os, sys, time
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Base:
    card = PolicyCard(name="under-test")
    def reset(self, instruction):
        self.instruction = instruction
    def act(self, observation):
        return Action()
"""

CHAIN = """
def chain(path, *, pause_s=0.0):
    '''Start processes in sessions of their own, each of which starts the next one, writes to a file, and ends.'''
    import ctypes
    if os.fork():
        return
    fork, beat = ctypes.CDLL(None).fork, os.open(path, os.O_RDWR | os.O_CREAT)
    until = time.monotonic() + 60
    while time.monotonic() < until:
        if fork():
            os._exit(0)
        os.setsid()
        os.pwrite(beat, str(time.monotonic_ns()).encode(), 0)
        time.sleep(pause_s)
    os._exit(0)
"""
"""Code that needs the modules os and time."""

Launch = Callable[..., PolicyProcess]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Launch]:
    """``launch(source, ...)``: a process for class P of a module with that source, closed at the end of the test.

    Its options are those of ``PolicyProcess``, and any others those of ``PolicySetup``.
    """
    opened: list[PolicyProcess] = []

    def start(
        source: str,
        *,
        first_deadline_s: float = 20.0,
        deadline_s: float = 20.0,
        **setup: Any,
    ) -> PolicyProcess:
        (tmp_path / "under_test.py").write_text(PREAMBLE + textwrap.dedent(source))
        places = {"search_path": (str(tmp_path),), "writable": (str(tmp_path),)}
        made = PolicySetup(ref=PolicyRef.parse("under_test:P"), **places | setup)
        opened.append(PolicyProcess(made, first_deadline_s=first_deadline_s, deadline_s=deadline_s))
        return opened[-1]

    yield start
    for process in opened:
        process.close()
