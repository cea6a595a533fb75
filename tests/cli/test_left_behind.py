"""Processes that a policy started end with its trial, or with whichever process is killed, however they hide."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from carecontact.hosting.isolation.system_calls import can_filter_calls
from tests.cli.test_stopping import _soon
from tests.hosting.conftest import PREAMBLE
from tests.processes import described

POLICY = """
import ctypes, subprocess
TOLD = os.path.join(os.path.dirname(__file__), "told")

def child(work):
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os._exit(0)
    return pid

def note():
    with open(os.path.join(TOLD, str(os.getpid())), "w"):
        pass

def without_a_mark():
    os.setsid()
    if os.fork() == 0:
        note()
        os.execve("/bin/sleep", ["sleep", "4321"], {})

def unreadable():
    ctypes.CDLL(None).prctl(4, 0, 0, 0, 0)
    os.setsid()
    note()
    time.sleep(4321)

def leaderless():
    import threading
    os.setsid()
    threading.Thread(target=time.sleep, args=(4321,)).start()
    note()
    ctypes.CDLL(None).pthread_exit(None)

def tracing():
    traced, above = os.getppid(), os.fork()
    if above == 0:
        os.setsid()
        note()
        time.sleep(0.5)  # Then no signal comes for the policy any more, at which it would stop.
        ctypes.CDLL(None).ptrace(0x4206, traced, 0, 0)
        time.sleep(4321)

class P(Base):
    def reset(self, instruction):
        started = subprocess.Popen(["sleep", "4321"])
        with open(os.path.join(TOLD, str(started.pid)), "w"):
            pass
        for work in (without_a_mark, unreadable, ALSO):
            child(work)
        until = time.monotonic() + 20
        while len(os.listdir(TOLD)) % 4 and time.monotonic() < until:
            time.sleep(0.02)
    def act(self, observation):
        WAIT
        return Action(done=True)
"""


def _alive(pid: int) -> bool:
    """Whether any of its threads runs."""
    with suppress(OSError):
        states = [path.read_text().rpartition(")")[2].split()[0] for path in Path(f"/proc/{pid}/task").glob("*/stat")]
        return any(state not in "ZX" for state in states)
    return False


def _parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def command(folder: Path, wait: str, *, also: str = "leaderless") -> list[str]:
    (folder / "told").mkdir()
    (folder / "temporary").mkdir()
    (folder / "mine.py").write_text(PREAMBLE + POLICY.replace("WAIT", wait).replace("ALSO", also))
    return [
        sys.executable, "-m", "carecontact", "run", "--policy", "mine:P", "--out", "r", "--tasks", "T1", "--seeds",
        "0-1", "--fast", "--jobs", "1", "--policy-write", "told",
    ]  # fmt: skip


def started(folder: Path) -> list[int]:
    return [int(path.name) for path in (folder / "told").iterdir()]


@pytest.fixture
def _killed(tmp_path: Path) -> Iterator[None]:
    yield
    for pid in started(tmp_path):
        if _alive(pid):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux lets a process adopt orphans")
@pytest.mark.usefixtures("_killed")
def test_they_end_with_the_trial(tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    began = time.monotonic()
    given = command(tmp_path, "time.sleep(1.0)", also="tracing")
    subprocess.run(given, cwd=tmp_path, check=True, env=environment, stdout=subprocess.DEVNULL)
    assert time.monotonic() - began < 60.0, "a process that traces the policy's held the trial up"
    assert len(started(tmp_path)) == 8
    assert not [pid for pid in started(tmp_path) if _alive(pid)]
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="Linux lets a process adopt orphans")
@pytest.mark.usefixtures("_killed")
@pytest.mark.parametrize("whom", ["command", "fork server", "worker", "keeper", "policy"])
def test_they_end_with_whoever_is_killed(tmp_path: Path, whom: str) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    wait = "open(os.path.join(TOLD, '0'), 'w').write(f'{os.getpid()} {os.getppid()}'); time.sleep(600)"
    run = subprocess.Popen(command(tmp_path, wait), cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)
    try:
        note = tmp_path / "told" / "0"
        assert _soon(lambda: note.exists() and len(note.read_text().split()) == 2, within_s=60)
        pids = dict(zip(("policy", "keeper"), map(int, note.read_text().split()), strict=True)) | {"command": run.pid}
        pids["worker"] = _parent(pids["keeper"])
        pids["fork server"] = _parent(pids["worker"])
        note.unlink()
        mine = started(tmp_path)
        assert len(mine) == 4
        assert all(map(_alive, mine))
        os.kill(pids[whom], signal.SIGKILL)
        assert _soon(lambda: not any(map(_alive, mine)), within_s=1), [described(pid) for pid in mine if _alive(pid)]
        if whom == "command":
            assert _soon(lambda: not list((tmp_path / "temporary").iterdir()), within_s=1)
    finally:
        run.kill()
        run.wait()
        time.sleep(1.0)


@pytest.mark.skipif(
    sys.platform != "linux" or not can_filter_calls(), reason="the command knows a policy's processes by their filter"
)
@pytest.mark.usefixtures("_killed")
def test_a_command_that_starts_a_policy_itself_finds_what_a_killed_keeper_leaves(tmp_path: Path) -> None:
    command(tmp_path, "open(os.path.join(TOLD, '0'), 'w').write(str(os.getppid())); time.sleep(600)")
    note = tmp_path / "told" / "0"
    check = subprocess.Popen(
        [sys.executable, "-m", "carecontact", "check", "mine:P", "--policy-write", "told"],
        cwd=tmp_path, stdout=subprocess.PIPE, env={**os.environ, "TMPDIR": str(tmp_path / "temporary")},
    )  # fmt: skip
    assert _soon(lambda: note.exists() and note.read_text() != "", within_s=60)
    keeper = int(note.read_text())
    note.unlink()
    mine = started(tmp_path)
    assert len(mine) == 4
    os.kill(keeper, signal.SIGABRT)
    said = check.communicate(timeout=60)[0].decode()
    assert "its process was killed without an answer, because the process that watches it was killed by SIGABRT" in said
    assert not [described(pid) for pid in mine if _alive(pid)]
    assert not list((tmp_path / "temporary").iterdir())
