"""Fake workers that one process forks for all tests: as a program of its own, each takes half a second to import."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from carecontact.running import supervisor
from carecontact.running.engine import TrialRequest
from carecontact.running.workers import Launcher, Process

FAKE = (sys.executable, str(Path(__file__).with_name("fake_worker.py")))
_SERVING: list[tuple[subprocess.Popen[bytes], socket.socket, Path]] = []


class FakeLauncher(Launcher):
    """Forks the workers of FAKE; each has the variables and the folder that this process has when it begins."""

    def __init__(self, command: Sequence[str], *, forks: bool = True) -> None:
        super().__init__(command, forks=forks)
        self._forks = self.command == FAKE and hasattr(os, "pidfd_open")

    def start(self, request: TrialRequest, *, log: Path) -> Process:
        if self._forks:
            self._serving()
            place, given = _SERVING[-1][2], json.dumps([os.getcwd(), dict(os.environ)])
            # Not twice in a run: a worker that was forked for its last trial may be reading it.
            if place.read_text() != given:
                place.write_text(given)
        return super().start(request, log=log)

    def close(self) -> None:
        """The process is that of all tests."""

    def _serving(self) -> tuple[subprocess.Popen[bytes], socket.socket]:
        if not _SERVING or _SERVING[-1][0].poll() is not None:
            # A file in memory, so that none is left behind.
            place = Path(f"/proc/{os.getpid()}/fd/{os.memfd_create('place')}")
            line, far = socket.socketpair()
            with far:
                server = subprocess.Popen(
                    (*FAKE, str(os.getpid()), str(place)),
                    stdin=far.fileno(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
                )  # fmt: skip
            _SERVING.append((server, line, place))
        return _SERVING[-1][:2]


def fork_fakes(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(supervisor, "Launcher", FakeLauncher)
