"""A run whose command is killed or loses its terminal leaves no process beside the next run."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from carecontact import cli
from tests.hosting.conftest import PREAMBLE
from tests.processes import NAMESPACE, alive, pid_here

POLICY = f"""
class P(Base):
    def reset(self, instruction):
        with open(os.path.join(os.path.dirname(__file__), "told", "pids.part"), "w") as file:
            file.write(f"{{os.getpid()}} {{{NAMESPACE}}} {{os.environ['TMPDIR']}}")
        os.rename(file.name, file.name.removesuffix(".part"))
        time.sleep(600)
"""


def _soon(true: Callable[[], bool], *, within_s: float) -> bool:
    until = time.monotonic() + within_s
    while not true() and time.monotonic() < until:
        time.sleep(0.05)
    return true()


class _Terminal:
    """Reads what is written to it, until it is closed: one that is not read fills up, and who writes to it waits."""

    def __init__(self) -> None:
        self._ours, self.theirs = pty.openpty()
        self._closed = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        with suppress(OSError):
            while not self._closed.is_set():
                if select.select([self._ours], [], [], 0.05)[0]:
                    os.read(self._ours, 4096)

    def close(self) -> None:
        if not self._closed.is_set():
            self._closed.set()
            self._reader.join()
            os.close(self._ours)


def _heeds_signals() -> None:
    """Under nohup, or in the background of a script, the tests inherit ignored signals, which the command would leave
    ignored."""
    for number in (signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_DFL)


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel kills worker and policy")
@pytest.mark.parametrize("how", ["SIGKILL", "SIGQUIT", "closed terminal"])
def test_nothing_is_left_running(tmp_path: Path, how: str, sandbox: bool) -> None:
    (tmp_path / "told").mkdir()
    (tmp_path / "mine.py").write_text(PREAMBLE + POLICY)
    command = [
        sys.executable, "-m", "carecontact", "run", "--policy", "mine:P", "--out", "r", "--tasks", "T1", "--seeds",
        "17", "--fast", "--policy-write", "told",
    ]  # fmt: skip
    terminal = _Terminal()
    theirs = terminal.theirs
    run = subprocess.Popen(
        ["setsid", "--ctty", *command] if how == "closed terminal" else command,
        cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs,
        preexec_fn=_heeds_signals,
    )  # fmt: skip
    os.close(theirs)
    try:
        assert _soon((tmp_path / "told" / "pids").exists, within_s=120)
        pid, namespace, temporary = (tmp_path / "told" / "pids").read_text().split()
        policy = pid_here(int(pid), namespace)
        watcher = int(Path(f"/proc/{policy}/stat").read_text().rpartition(")")[2].split()[1])
        processes = [policy, watcher, run.pid]
        assert all(map(alive, processes))
        if how == "closed terminal":
            terminal.close()
        else:
            run.send_signal(getattr(signal, how))
        assert run.wait(20) == (-signal.SIGKILL if how == "SIGKILL" else cli.INTERRUPTED)
        assert _soon(lambda: not any(map(alive, processes)), within_s=1)
        if how != "SIGKILL":
            assert sandbox or _soon(lambda: not Path(temporary).exists(), within_s=1)
            assert not list((tmp_path / "r").glob(".running-*"))
    finally:
        run.kill()
        run.wait()
        terminal.close()


def test_what_the_caller_ignores_stays_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    """As under nohup."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)}
    try:
        _heeds_signals()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        cli.main(["list", "policies"])
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGQUIT)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
