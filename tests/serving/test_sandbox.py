"""Nothing that a policy starts outlives it or the harness, whatever it does, and whatever the harness is."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import carecontact
from carecontact.errors import ExhaustedError, PolicyError
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import _BOOTSTRAP, PolicyProcess  # pyright: ignore[reportPrivateUsage]
from tests.policies.synthetic import SESSION
from tests.processes import NAMESPACE, alive, described, pid_here
from tests.serving.conftest import CHAIN, PREAMBLE, Launch

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="Linux has namespaces, and lets a process adopt orphans"),
    pytest.mark.usefixtures("sandbox"),
]

POLICY = (
    CHAIN
    + f"NAMESPACE = {NAMESPACE}\n"
    + """
class P(Base):
    def __init__(self, *, then: str = "lives"):
        # In a session of its own, without the variables that the policy was given, by a shell that ends.
        born = os.path.join(os.path.dirname(__file__), "born")
        os.system("env -i setsid sh -c 'echo $$ %s >> %s; exec sleep 4321' & exit 0" % (NAMESPACE, born))
        while not (os.path.exists(born) and open(born).read().endswith("\\n")):
            time.sleep(0.01)
        if then == "dies":
            os._exit(3)
        if then == "raises":
            raise ValueError(then)
        if then == "hangs":
            time.sleep(60)
    def reset(self, instruction):
        os.kill(os.getpid(), 11)
    def act(self, observation):
        return Action(done=True)

class Chains(P):
    def reset(self, instruction):
        beat = os.path.join(os.path.dirname(__file__), "beat")
        for n in range(6):
            chain(beat)
        while not (os.path.exists(beat) and os.path.getsize(beat)):
            time.sleep(0.01)
"""
)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(PREAMBLE + POLICY)
    return tmp_path / "one", tmp_path / "two"


def process(
    folder: Path, *, deadline_s: float = 20.0, then: str = "lives", name: str = "P", isolated: bool = True
) -> PolicyProcess:
    made = PolicySetup.of(f"mine:{name}", search_path=[str(folder)])
    setup = PolicySetup(
        ref=made.ref, search_path=made.search_path, arguments={"then": then}, writable=(str(folder),), isolated=isolated
    )
    return PolicyProcess(setup, first_deadline_s=deadline_s, deadline_s=deadline_s)


def started(folder: Path) -> int | None:
    """The process that the policy of this folder started; None if it is gone."""
    pid, namespace = (folder / "born").read_text().split()
    return pid_here(int(pid), namespace)


def lives(folder: Path) -> bool:
    return alive(started(folder))


def soon(true: Callable[[], bool], *, within_s: float = 1.0) -> bool:
    until = time.monotonic() + within_s
    while not true() and time.monotonic() < until:
        time.sleep(0.02)
    return true()


def test_each_policy_of_one_harness_takes_its_own_along(folders: tuple[Path, Path]) -> None:
    one, two = map(process, folders)
    one.start()
    two.start()
    assert all(map(lives, folders))
    one.close()
    assert [lives(folder) for folder in folders] == [False, True]
    with pytest.raises(PolicyError, match="killed by SIGSEGV"):
        two.reset("touch", SESSION)
    assert not lives(folders[1])


@pytest.mark.parametrize(
    ("then", "says"), [("dies", "exit code 3"), ("raises", "ValueError: raises"), ("hangs", "not ready within 2.5 s")]
)
def test_a_policy_that_fails_in_its_constructor_takes_them_along(
    folders: tuple[Path, Path], then: str, says: str
) -> None:
    with pytest.raises(PolicyError, match=says):
        process(folders[0], then=then, deadline_s=2.5 if then == "hangs" else 20.0).start()
    assert (folders[0] / "born").exists()
    assert not lives(folders[0])


@pytest.mark.parametrize("isolated", [True, False])
def test_processes_that_fork_and_end_at_once_do_not_outrun_it(folders: tuple[Path, Path], isolated: bool) -> None:
    made = process(folders[0], name="Chains", isolated=isolated)
    made.start()
    made.reset("touch", SESSION)
    made.close()
    beat = folders[0] / "beat"
    last = beat.read_bytes()
    time.sleep(0.3)
    assert beat.read_bytes() == last


def harness(folder: Path, temporary: Path, end: str) -> int:
    """Run another process that starts the policy of this folder as ``made`` and then runs the code ``end``."""
    temporary.mkdir(exist_ok=True)
    code = (
        "import os, sys, threading, time; sys.path[:0] = sys.argv[1:3]\n"
        "from tests.serving.test_sandbox import Path, process\n"
        f"made = process(Path(sys.argv[3])); made.start(); {end}"
    )
    places = [str(Path(carecontact.__file__).parents[1]), str(Path(__file__).parents[2])]
    command = [sys.executable, "-c", code, *places, str(folder)]
    return subprocess.run(command, env={**os.environ, "TMPDIR": str(temporary)}, check=False).returncode


@pytest.mark.parametrize("number", [9, 15])
def test_they_go_with_a_harness_that_is_killed_and_so_does_the_policys_folder(
    folders: tuple[Path, Path], tmp_path: Path, number: int
) -> None:
    temporary = tmp_path / "temporary"
    assert harness(folders[0], temporary, f"os.kill(os.getpid(), {number})") == -number
    assert (folders[0] / "born").exists()
    assert soon(lambda: not lives(folders[0])), described(started(folders[0]))
    assert soon(lambda: not list(temporary.iterdir()))


@pytest.mark.parametrize(
    "pause_s", [0.0, pytest.param(0.01, marks=pytest.mark.slow), 0.03, pytest.param(0.1, marks=pytest.mark.slow)]
)
def test_the_policys_folder_goes_although_the_harness_ends_while_it_closes_the_policy(
    folders: tuple[Path, Path], tmp_path: Path, pause_s: float
) -> None:
    temporary = tmp_path / "temporary"
    end = f"threading.Thread(target=made.close).start(); time.sleep({pause_s}); os._exit(0)"
    assert harness(folders[0], temporary, end) == 0
    assert soon(lambda: not list(temporary.iterdir()))


@pytest.mark.parametrize("ignored", [False, True], ids=["blocked", "ignored"])
@pytest.mark.parametrize("act", [11, 40])
def test_how_a_policy_ended_is_known_although_the_caller_does_not_receive_sigchld(
    launch: Launch, act: int, ignored: bool
) -> None:
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [] if ignored else [signal.SIGCHLD])
    handler = signal.signal(signal.SIGCHLD, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        made = launch(f"""
            class P(Base):
                def reset(self, instruction):
                    os.kill(os.getpid(), {act})
        """)
        made.start()
        with pytest.raises(PolicyError, match=r"its process was killed by (SIGSEGV|signal 40)") as failure:
            made.reset("touch", SESSION)
    finally:
        signal.signal(signal.SIGCHLD, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    assert failure.value.kind == "died"


@pytest.mark.parametrize("number", [signal.SIGABRT, signal.SIGKILL])
def test_a_lost_watcher_is_a_kill_that_is_no_failure_of_the_policy(launch: Launch, number: int) -> None:
    made = launch("""
        class P(Base):
            def reset(self, instruction):
                time.sleep(60)
    """)
    made.start()
    assert made._child is not None
    threading.Timer(0.3, os.kill, (made._child.pid, number)).start()
    with pytest.raises(PolicyError, match=f"that watches it was killed by {signal.Signals(number).name}") as failure:
        made.reset("touch", SESSION)
    assert failure.value.kind == "killed"


def test_a_policy_in_namespaces_sees_itself_alone(launch: Launch, sandbox: bool, tmp_path: Path) -> None:
    """Its own processes, shared memory and temporary files; it is killed by what it does to itself and by no other."""
    if not sandbox:
        pytest.skip("this is what namespaces are for")
    outside = Path(tempfile.mkdtemp(dir="/tmp"))
    made = launch(
        """
        import json, tempfile
        from multiprocessing import Pool, shared_memory
        class P(Base):
            def reset(self, instruction):
                shared = shared_memory.SharedMemory("carecontact-test", create=True, size=4096)
                with Pool(2) as pool:
                    lengths = pool.map(len, ["a", "bc"])
                left = os.path.exists("/dev/shm/left") or os.path.exists(tempfile.gettempdir() + "/left")
                for place in ("/dev/shm", tempfile.gettempdir()):
                    open(place + "/left", "w").close()
                print(json.dumps([os.getppid(), lengths, left, os.path.exists(OUTSIDE), os.getcwd()]))
                try:
                    os.kill(1, 9)
                finally:
                    os.kill(os.getpid(), 9)
    """.replace("OUTSIDE", repr(str(outside)))
    )
    try:
        for _ in range(2):
            made.start()
            with pytest.raises(PolicyError, match="its process was killed by SIGKILL"):
                made.reset("touch", SESSION)
            # Python may warn of the shared memory afterwards.
            seen = json.loads(next(line for line in made.printed.splitlines() if line.startswith("[")))
            assert seen == [0, [1, 2], False, False, os.getcwd()]
    finally:
        outside.rmdir()
    assert not Path("/dev/shm/carecontact-test").exists()
    assert not Path("/dev/shm/left").exists()


def test_descriptors_may_have_large_numbers(launch: Launch) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    many = 1100
    if hard != resource.RLIM_INFINITY and hard < 2 * many:
        pytest.skip("this system permits too few open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (2 * many, hard))
    held = [os.open(os.devnull, os.O_RDONLY) for _ in range(many)]
    try:
        made = launch("""
            class P(Base):
                def reset(self, instruction):
                    os.kill(os.getpid(), 11)
        """)
        made.start()
        with pytest.raises(PolicyError, match="killed by SIGSEGV without an answer\\nit crashed here"):
            made.reset("touch", SESSION)
    finally:
        for descriptor in held:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_harness_without_descriptors_says_so_and_keeps_none(
    launch: Launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    made = launch("class P(Base): pass")
    before, failures = len(os.listdir("/proc/self/fd")), list[int | None]()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    for left in range(40):
        resource.setrlimit(resource.RLIMIT_NOFILE, (before - 1 + left, hard))
        try:
            made.start()
            made.close()
            break
        except OSError as error:
            failures.append(error.errno)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert len(os.listdir("/proc/self/fd")) == before
        assert not list(tmp_path.glob("carecontact-policy-*"))
    assert set(failures) == {errno.EMFILE}
    assert 4 < len(failures) < 40


def test_many_files_that_a_policy_leaves_are_removed_beside_what_comes_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the disk; in memory, they go at once."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "mine.py").write_text(
        PREAMBLE
        + """
import tempfile
class P(Base):
    def __init__(self, *, then):
        pass
    def reset(self, instruction):
        for n in range(1000):
            os.mkdir(f"{tempfile.gettempdir()}/{n}")
"""
    )
    made = process(tmp_path)
    made.start()
    made.reset("touch", SESSION)
    monkeypatch.setattr("carecontact.serving.process.REMOVAL_S", 0.0)
    made.close()
    with process(tmp_path, deadline_s=20.0) as another:
        another.start()
    assert soon(lambda: not list((tmp_path / "temporary").iterdir()), within_s=60.0)


def test_a_policy_that_ends_before_it_is_watched_is_noticed() -> None:
    """A signal of its end that comes before the handler is lost."""
    code = """
import os, signal
from carecontact.serving import sandbox
ours, theirs = os.pipe()
policy = os.fork()
if policy == 0:
    os._exit(7)
os.waitid(os.P_PID, policy, os.WEXITED | os.WNOWAIT)
statuses = {policy: None}
signal.alarm(20)
sandbox._wait(policy, ours, statuses)
print(statuses[policy])
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "7"


def test_a_fork_that_is_refused_is_no_failure_of_the_policy(launch: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = "import os\ndef refused(): raise BlockingIOError(11, 'not now')\nos.fork = refused\n"
    monkeypatch.setattr(
        "carecontact.serving.process._BOOTSTRAP",
        _BOOTSTRAP.replace("start(options)", f"{refused}start(options)"),
    )
    for _ in range(8):  # The pipe to that process ends before the process does.
        made = launch("class P(Base): pass")
        with pytest.raises(ExhaustedError, match="not now"):
            made.start()
