"""Workers are forked from a server, or are programs of their own where there is none."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import psutil
import pytest

import carecontact
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import canonical_hash, read_header, read_recording
from carecontact.running.engine import StatusPipe, TrialRequest
from carecontact.running.workers import ForkedProcess, Launcher, Process
from carecontact.serving.conversation import PolicySetup
from tests.processes import described
from tests.serving.served import served

pytestmark = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="nothing is forked on this system")
PATIENCE_S = 60.0


@pytest.fixture
def launcher() -> Iterator[Launcher]:
    made = Launcher()
    yield made
    made.close()


def start(
    launcher: Launcher, out: Path, *, policy: str = "nowhere:Nothing", seed: int = 0
) -> tuple[Process, StatusPipe]:
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=seed, policy=policy)
    pipe, status_fd = os.pipe()
    request = TrialRequest(spec=spec, policy=PolicySetup.of(policy), out=out, status_fd=status_fd)
    process = launcher.start(request, log=out.with_suffix(".log"))
    os.close(status_fd)
    return process, StatusPipe(pipe)


def soon(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def stat(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def gone(pid: int) -> bool:
    try:
        return stat(pid)[0] in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return True


def test_a_forked_trial_is_that_of_a_program_and_knows_nothing_of_the_one_before(
    launcher: Launcher, tmp_path: Path
) -> None:
    outs = [tmp_path / f"{k}.h5" for k in range(3)]
    for out, seed in zip(outs, (0, 1, 0), strict=True):
        process, status = start(launcher, out, seed=seed)
        assert isinstance(process, ForkedProcess)
        assert process.wait() == 0, out.with_suffix(".log").read_text()
        status.read()
        assert not status.policy_runs
    first, other, again = (canonical_hash(read_recording(out)) for out in outs)
    assert first == again != other
    process, _ = start(Launcher(forks=False), alone := tmp_path / "alone.h5")
    assert isinstance(process, subprocess.Popen)
    assert process.wait() == 0
    assert canonical_hash(read_recording(alone)) == first
    assert {read_header(out).origin for out in (*outs, alone)} == {"isolated"}


def test_a_worker_says_that_a_policy_is_served_elsewhere(launcher: Launcher, tmp_path: Path) -> None:
    source = """
        class P:
            card = PolicyCard(name="at once", cameras=())
            def reset(self, instruction): pass
            def act(self, observation): return Action(done=True)
    """
    with served(source, tmp_path) as (port, _):
        process, _ = start(launcher, out := tmp_path / "served.h5", policy=f"ws://127.0.0.1:{port}")
        assert process.wait() == 0, out.with_suffix(".log").read_text()
    assert read_header(out).origin == "served"


def descriptors(pid: int) -> set[str]:
    """What a process has open; what it closes meanwhile is left out."""
    found: set[str] = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            end = os.readlink(fd)
            if end == "anon_inode:[pidfd]":
                # All have this name; the process that one stands for tells them apart.
                end += Path(f"/proc/{pid}/fdinfo/{fd.name}").read_text().partition("Pid:")[2].split()[0]
            found.add(end)
    return found


def test_a_forked_worker_has_no_descriptor_of_the_server_or_of_another(launcher: Launcher, tmp_path: Path) -> None:
    one, status = start(launcher, tmp_path / "one.h5", policy="hover")
    two, _ = start(launcher, tmp_path / "two.h5", policy="hover")
    soon(lambda: (status.read(), status.policy_runs)[1])
    server = int(stat(one.pid)[1])
    ends = [descriptors(pid) for pid in (one.pid, two.pid, server)]
    for k, mine in enumerate(ends[:2]):
        others = set[str]().union(*ends[:k], *ends[k + 1 :])
        assert {end for end in mine & others if end.startswith(("pipe:", "socket:", "anon_inode:"))} == set()
    for process in (one, two):
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL


@pytest.mark.parametrize("forks", [True, False], ids=["the fork server", "a worker"])
def test_what_has_hardly_started_ends_with_a_command_that_is_killed(tmp_path: Path, forks: bool) -> None:
    code = (
        "import sys; sys.path[:0] = sys.argv[1:3]\n"
        "from tests.running.test_workers import Launcher, Path, start\n"
        "start(Launcher(forks=sys.argv[4] == 'True'), Path(sys.argv[3])); sys.stdin.read()"
    )
    places = [str(Path(carecontact.__file__).parents[1]), str(Path(__file__).parents[2])]
    command = subprocess.Popen(
        [sys.executable, "-c", code, *places, str(tmp_path / "trial.h5"), str(forks)], stdin=subprocess.PIPE
    )
    while not (started := psutil.Process(command.pid).children()):
        assert command.poll() is None
    command.kill()
    command.wait()
    time.sleep(1.0)  # What it imports takes longer.
    assert gone(started[0].pid), described(started[0].pid)


def test_a_killed_worker_is_noticed(launcher: Launcher, tmp_path: Path) -> None:
    process, _ = start(launcher, tmp_path / "trial.h5", policy="hover")
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == process.poll() == -signal.SIGKILL


def test_what_a_lost_server_forked_dies_and_the_next_worker_is_a_program(launcher: Launcher, tmp_path: Path) -> None:
    process, _ = start(launcher, tmp_path / "trial.h5", policy="hover")
    server = int(stat(process.pid)[1])
    os.kill(server, signal.SIGKILL)
    soon(lambda: process.poll() is not None)
    assert process.returncode == -signal.SIGKILL
    soon(lambda: gone(process.pid))
    after, _ = start(launcher, tmp_path / "after.h5")
    assert isinstance(after, subprocess.Popen)
    assert after.wait() == 0
    assert read_recording(tmp_path / "after.h5").header.ended == "process_failure"


def test_closing_leaves_no_process(tmp_path: Path) -> None:
    launcher = Launcher()
    process, _ = start(launcher, tmp_path / "trial.h5", policy="hover")
    server = int(stat(process.pid)[1])
    launcher.close()
    soon(lambda: gone(server) and gone(process.pid))


def test_no_module_that_a_worker_needs_starts_a_thread_when_it_is_imported() -> None:
    program = "from carecontact.running.fork_server import prepare; prepare()"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_server_that_cannot_fork_says_so_and_goes_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What it forked before does not end with it."""
    code = (
        "import os; forks, fork = [], os.fork\n"
        "def some():\n"
        "    forks.append(0)\n"
        "    if len(forks) == 2: raise BlockingIOError(11, 'Resource temporarily unavailable')\n"
        "    return fork()\n"
        "os.fork = some\n"
        "from carecontact.running.fork_server import main; main()"
    )
    monkeypatch.setattr("carecontact.running.workers.SERVER_COMMAND", (sys.executable, "-P", "-c", code))
    with closing(Launcher()) as launcher:
        one, _ = start(launcher, tmp_path / "one.h5")
        with pytest.raises(BlockingIOError):
            start(launcher, tmp_path / "two.h5")
        three, _ = start(launcher, tmp_path / "three.h5")
        assert isinstance(three, ForkedProcess)
        assert (one.wait(), three.wait()) == (0, 0)
