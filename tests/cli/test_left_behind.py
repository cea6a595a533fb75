"""Processes that a policy started end with its trial, or with whichever process is killed, however they hide."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.test_run import _soon
from tests.processes import NAMESPACE, alive, described, pid_here
from tests.serving.conftest import PREAMBLE

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="Linux has namespaces, and lets a process adopt orphans"),
    pytest.mark.usefixtures("sandbox"),
]

POLICY = f"""
import ctypes, subprocess
NAMESPACE = {NAMESPACE}
"""
POLICY += """
TOLD = os.path.join(os.path.dirname(__file__), "message")

def child(work):
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os._exit(0)
    return pid

def note():
    with open(os.path.join(TOLD, f"{os.getpid()} {NAMESPACE}"), "w"):
        pass

def orphaned():
    os.setsid()
    if os.fork() == 0:
        note()
        os.execve("/bin/sleep", ["sleep", "4321"], {})

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
        with open(os.path.join(TOLD, f"{started.pid} {NAMESPACE}"), "w"):
            pass
        for work in (orphaned, ALSO):
            child(work)
        until = time.monotonic() + 20
        while len(os.listdir(TOLD)) % 3 and time.monotonic() < until:
            time.sleep(0.02)
    def act(self, observation):
        WAIT
        return Action(done=True)
"""


def _parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def command(folder: Path, wait: str, *, also: str = "leaderless") -> list[str]:
    (folder / "message").mkdir()
    (folder / "temporary").mkdir()
    (folder / "mine.py").write_text(PREAMBLE + POLICY.replace("WAIT", wait).replace("ALSO", also))
    return [
        sys.executable, "-m", "carecontact", "run", "--policy", "mine:P", "--out", "r", "--tasks", "T1", "--seeds",
        "0-1", "--fast", "--protocol", "bathing-v3", "--jobs", "1", "--policy-write", ".",
    ]  # fmt: skip


def ids(folder: Path) -> list[tuple[int, str]]:
    """Id and namespace of each process that the policy of this folder started."""
    printed = [path.name.split() for path in folder.glob("message/*")]
    return [(int(pid), namespace) for pid, namespace in printed]


def started(folder: Path) -> list[int]:
    """The processes among them that live, by their ids here."""
    return [pid for each in ids(folder) if (pid := pid_here(*each)) is not None and alive(pid)]


@pytest.fixture
def _killed(tmp_path: Path) -> Iterator[None]:
    yield
    for pid in started(tmp_path):
        os.kill(pid, signal.SIGKILL)


@pytest.mark.usefixtures("_killed")
def test_they_end_with_the_trial(tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    began = time.monotonic()
    given = command(tmp_path, "time.sleep(1.0)", also="tracing")
    subprocess.run(given, cwd=tmp_path, check=True, env=environment, stdout=subprocess.DEVNULL)
    assert time.monotonic() - began < 60.0, "a process that traces the policy's held the trial up"
    assert len(ids(tmp_path)) == 6 or len({namespace for _, namespace in ids(tmp_path)}) == 1
    assert not [described(pid) for pid in started(tmp_path)]
    assert not list((tmp_path / "temporary").iterdir())


WAIT = "open(os.path.join(TOLD, '..', 'note'), 'w').write(f'{os.getpid()} {NAMESPACE}'); time.sleep(600)"


def policy_of(folder: Path) -> int:
    """Wait until the policy has noted its id; return its id here."""
    note = folder / "note"
    assert _soon(lambda: note.exists() and len(note.read_text().split()) == 2, within_s=60)
    pid, namespace = note.read_text().split()
    note.unlink()
    found = pid_here(int(pid), namespace)
    assert found is not None
    return found


QUICK = {("command", "off"), ("fork server", ""), ("worker", "off"), ("watcher", ""), ("policy", "off")}
"""Each process once; with the other kind of system it is a slow test."""
KILLED = [
    pytest.param(whom, kind, marks=[] if (whom, kind) in QUICK else pytest.mark.slow, id=f"{whom} {kind}")
    for whom in ("command", "fork server", "worker", "watcher", "policy")
    for kind in ("", "off")
]


@pytest.mark.usefixtures("_killed")
@pytest.mark.parametrize(("whom", "sandbox"), KILLED, indirect=["sandbox"])
def test_they_end_with_any_process_that_is_killed(tmp_path: Path, whom: str) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    run = subprocess.Popen(command(tmp_path, WAIT), cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)
    try:
        pids = {"policy": policy_of(tmp_path), "command": run.pid}
        pids["watcher"] = _parent(pids["policy"])
        pids["worker"] = _parent(pids["watcher"])
        pids["fork server"] = _parent(pids["worker"])
        mine = started(tmp_path)
        assert len(mine) == 3
        os.kill(pids[whom], signal.SIGKILL)
        assert _soon(lambda: not any(map(alive, mine)), within_s=1), [described(pid) for pid in mine if alive(pid)]
        if whom == "command":
            assert _soon(lambda: not list((tmp_path / "temporary").iterdir()), within_s=1)
    finally:
        run.kill()
        run.wait()
        time.sleep(1.0)


@pytest.mark.usefixtures("_killed")
def test_a_command_that_starts_a_policy_itself_leaves_nothing_when_the_watcher_is_killed(
    tmp_path: Path, sandbox: bool
) -> None:
    if not sandbox:
        pytest.skip("without namespaces, no one knows these processes then (docs/evidence/threat-model.md)")
    command(tmp_path, WAIT)
    check = subprocess.Popen(
        [sys.executable, "-m", "carecontact", "check", "mine:P", "--policy-write", "."],
        cwd=tmp_path, stdout=subprocess.PIPE, env={**os.environ, "TMPDIR": str(tmp_path / "temporary")},
    )  # fmt: skip
    watcher = _parent(policy_of(tmp_path))
    mine = started(tmp_path)
    assert len(mine) == 3
    os.kill(watcher, signal.SIGABRT)
    printed = check.communicate(timeout=60)[0].decode()
    assert (
        "its process was killed without an answer, because the process that watches it was killed by SIGABRT" in printed
    )
    assert not [described(pid) for pid in mine if alive(pid)]
    assert not list((tmp_path / "temporary").iterdir())
