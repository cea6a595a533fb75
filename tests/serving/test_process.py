from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import carecontact
from carecontact.errors import ExhaustedError, ObservationError, PolicyError
from carecontact.serving import codec
from carecontact.serving import process as harness_process
from carecontact.serving.fence import available
from carecontact.serving.packing import pack
from carecontact.serving.process import PolicyProcess
from tests.policies import synthetic
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.processes import NAMESPACE, alive, pid_here
from tests.serving.conftest import PREAMBLE, Launch

either = pytest.mark.usefixtures("sandbox")
"""For tests of what the kernel does: with and without namespaces. All others run as this system runs policies."""


def _failure(process: PolicyProcess, *, at: str) -> PolicyError:
    """Run the conversation; the PolicyError has to come at that call and leave no process."""
    if at != "start":
        process.start()
    if at == "act":
        process.reset("touch", SESSION)
    calls = {
        "start": process.start,
        "reset": lambda: process.reset("touch", SESSION),
        "act": lambda: process.act(synthetic_observation()),
    }
    with pytest.raises(PolicyError) as caught:
        calls[at]()
    assert _children() == []
    return caught.value


def _begun(process: PolicyProcess, *, acts: int = 0) -> PolicyProcess:
    process.start()
    process.reset("touch", SESSION)
    for _ in range(acts):
        process.act(synthetic_observation())
    return process


_OTHERS: set[int] = set()
"""Children of earlier tests of this process: the interpreter of voxposer's programs keeps a pool of its own."""


@pytest.fixture(autouse=True)
def _no_process_stays() -> Iterator[None]:
    _OTHERS.clear()
    if not Path("/proc/self/task").is_dir():
        pytest.skip("lists child processes through /proc")
    _OTHERS.update(_children())
    yield
    assert _children() == []


def _children(pid: int | str = "self") -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(FileNotFoundError):  # a thread that ends meanwhile has no children either
            found += [int(pid) for pid in (task / "children").read_text().split()]
    return [pid for pid in found if pid not in _OTHERS]


@either
def test_a_conversation(launch: Launch) -> None:
    process = launch(
        """
        class P(Base):
            card = PolicyCard(name="answers", modalities=("rgb",), cameras=("overhead",), control_hz=5)
            def configure(self, session):
                self.low = session.action_bounds.workspace_low_m
            def act(self, observation):
                seen = observation.cameras["overhead"].rgb
                pose = observation.pose_tcp_in_base
                pose[0] = seen.mean() / 1000
                pose[1] = self.low[0]
                pose[3:] *= 1.005
                return [Action(pose_tcp_in_base=pose), Action(stiffness=(200, 10), done=True)]
        """
    )
    card = process.start()
    assert (card.name, card.modalities, card.control_hz) == ("answers", ("rgb",), 5)
    process.reset("touch", SESSION)
    view = synthetic_view()
    observation = synthetic_observation(cameras={"overhead": view})
    reply = process.act(observation)
    first, last = reply.actions
    np.testing.assert_allclose(first.pose_tcp_in_base[:3], [view.rgb.mean() / 1000, -0.2, 0.4])
    assert np.linalg.norm(first.pose_tcp_in_base[3:]) == pytest.approx(1.005), "as the policy sent it"
    assert (last.stiffness, last.done) == ((200.0, 10.0), True)
    sent = pack({"type": "act", "observation": codec.encode_observation(observation)})
    assert (reply.sent_sha256, reply.sent) == (hashlib.sha256(sent).digest(), sent)
    assert process.act(observation).sent_sha256 == reply.sent_sha256
    process.close()
    process.close()


@either
@pytest.mark.parametrize(
    ("act", "kind", "says"),
    [
        (
            "print('last words'); os._exit(0)",
            "died",
            r"act: its process ended itself with exit code 0 without an answer\nit printed last:\nlast words$",
        ),
        ("os.kill(os.getpid(), 9)", "killed", "act: its process was killed by SIGKILL without an answer$"),
        (
            "os.kill(os.getpid(), 11)",
            "died",
            r"killed by SIGSEGV without an answer\nit crashed here \(most recent call last\):\n"
            r'  File ".*/under_test\.py", line \d+, in act$',
        ),
        ("raise ValueError('no plan ' + 'x' * 9)", "exception", "ValueError: no plan xxx"),
        ("raise ValueError(chr(0xD800))", "exception", "ValueError"),
        ("raise ValueError('boom ' * 99999)", "exception", r"in act\n(?s:.*)\nValueError: boom boom .*\[\.\.\.\]$"),
        ("raise ValueError('\\x1b[2J\\0red')", "exception", r"ValueError: \\x1b\[2J\\x00red$"),
        ("os.write(1, b'\\x1b[31mred\\n'); os._exit(3)", "died", r"it printed last:\n\\x1b\[31mred$"),
        ("sys.exit('enough')", "exception", "SystemExit: enough"),
        ("server.pack = lambda m: b'\\xc1 not msgpack'", "garbage", "expected msgpack"),
        ("server.pack = lambda m: bytes(5 << 20)", "oversize", "at most 4194304 bytes"),
    ],
)
def test_a_failing_act(launch: Launch, act: str, kind: str, says: str) -> None:
    process = launch(
        f"""
        from carecontact.serving import server
        class P(Base):
            def act(self, observation):
                {act}
                return Action()
        """
    )
    error = _failure(process, at="act")
    assert error.kind == kind
    assert error.args[0].startswith("policy 'under_test:P' failed at act: ")
    assert re.search(says, str(error)), str(error)
    with pytest.raises(RuntimeError, match=r"nothing after a failure or close\(\)"):
        process.act(synthetic_observation())


@pytest.mark.parametrize(
    ("body", "at", "kind", "says"),
    [
        ("import mujoco", "start", "start", "mujoco is closed to policies"),
        ("import carecontact.scoring", "start", "start", "carecontact.scoring is closed to policies"),
        ("class P(Base):\n    def __init__(self): 1 / 0", "start", "start", "ZeroDivisionError"),
        ("class Q(Base): pass", "start", "start", "has no 'P'; it has Base, Q"),
        ("class P:\n    card = Base.card", "start", "start", "no method reset or act"),
        ("def broken(:", "start", "start", "SyntaxError"),
        ("os._exit(0)", "start", "start", r"ended itself with exit code 0 before it was ready"),
        ("class P(Base):\n    card = None", "start", "handshake", "expected a PolicyCard, got NoneType"),
        (
            "class P(Base):\n    def reset(self, instruction): raise KeyError(instruction)",
            "reset",
            "exception",
            "touch",
        ),
    ],
)
def test_a_failing_start(launch: Launch, body: str, at: str, kind: str, says: str) -> None:
    error = _failure(launch(body), at=at)
    assert error.kind == kind
    assert re.search(says, str(error)), str(error)


@pytest.mark.parametrize(
    ("written", "kind"),
    [
        ("b'not JSON\\n'", "garbage"),
        ("b'[' * 100_000 + b'\\n'", "garbage"),
        ("b'[]\\n'", "garbage"),
        ("b'{\"port\": null}\\n'", "garbage"),
        ("b'{\"port\": 99999}\\n'", "garbage"),
        ("b'{\"port\": 1e999}\\n'", "garbage"),
        ("b'{\"port\": true}\\n'", "garbage"),
        ('b\'{"error": "x", "kind": "timeout"}\\n\'', "start"),
        ('b\'{"error": "x", "kind": 3}\\n\'', "start"),
        ("bytes(3 << 20)", "oversize"),
    ],
)
def test_a_policy_that_writes_its_own_report_fails_by_itself(
    launch: Launch, tmp_path: Path, written: str, kind: str
) -> None:
    """An error of the harness would count against no policy."""
    process = launch(
        f"""
        import sys
        fd, left = sys.modules["carecontact.serving.child"].RECEIVED["report_fd"], {written}
        while left:
            left = left[os.write(fd, left):]
        time.sleep(60)
        """
    )
    assert _failure(process, at="start").kind == kind
    assert process.isolation == f"{available()}; --policy-write {tmp_path}"


@either
@pytest.mark.parametrize(
    "act",
    [
        "time.sleep(60)",
        "os.kill(os.getpid(), 19)",
        "os.fork() and time.sleep(60) or time.sleep(60)",
        "print('x' * 100_000_000)\n                time.sleep(60)",
    ],
    ids=["sleeps", "stopped", "forks", "floods"],
)
def test_a_hanging_act_is_killed(launch: Launch, monkeypatch: pytest.MonkeyPatch, act: str) -> None:
    monkeypatch.setattr("carecontact.serving.process.STACK_PATIENCE_S", 0.2)
    process = launch(
        f"""
        class P(Base):
            def act(self, observation):
                if observation.sim_time_s == 0:
                    return Action()
                {act}
        """,
        deadline_s=0.3,
    )
    _begun(process, acts=1)
    with pytest.raises(PolicyError, match=r"no actions message within 0\.3 s") as caught:
        process.act(synthetic_observation(sim_time_s=0.1))
    assert caught.value.kind == "timeout"
    assert len(str(caught.value)) < 10_000


@either
def test_a_policy_that_hangs_is_asked_for_its_stack(launch: Launch) -> None:
    """Without the frames of the harness, most recent call last; what it printed comes after it."""
    process = launch(
        """
        class P(Base):
            def act(self, observation):
                if observation.sim_time_s == 0:
                    return Action()
                print("waiting for the GPU")
                self.wait()
            def wait(self):
                time.sleep(60)
        """,
        deadline_s=1.0,
    )
    _begun(process, acts=1)
    with pytest.raises(PolicyError) as caught:
        process.act(synthetic_observation(sim_time_s=0.1))
    assert re.search(
        r"within 1 s\nit hung here \(most recent call last\):\n"
        r'  File ".*/under_test\.py", line 19, in act\n  File ".*/under_test\.py", line 21, in wait\n'
        r"it printed last:\nwaiting for the GPU$",
        str(caught.value),
    ), str(caught.value)


@either
@pytest.mark.parametrize("then", ["time.sleep(60)", "os.closerange(0, 64); time.sleep(60)"], ids=["hangs", "closes"])
def test_a_policy_may_write_on_and_on_where_its_stack_belongs(
    launch: Launch, monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    """Reading the stack ends after WHOLE_S."""
    monkeypatch.setattr("carecontact.serving.process_tree.WHOLE_S", 0.2)
    process = launch(
        f"""
        class P(Base):
            def reset(self, instruction):
                pipes = [n for n in range(3, 64) if os.path.exists(f"/proc/self/fd/{{n}}")]
                kept = [os.dup(n) for n in pipes if os.readlink(f"/proc/self/fd/{{n}}").startswith("pipe:")]
                kept = [os.dup2(n, 100 + n) for n in kept]
                if os.fork() == 0:
                    while True:
                        for pipe in kept:
                            os.write(pipe, b"x")
                        time.sleep(0.03)
                {then}
        """
    )
    process.start()
    process._first_deadline_s = 0.5
    with pytest.raises(PolicyError):
        process.reset("touch", SESSION)


def _no_thread(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def _no_process(*given: object, **more: object) -> None:
    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))


@either
@pytest.mark.parametrize(
    ("made", "method", "refused"),
    [(threading.Thread, "start", _no_thread), (subprocess.Popen, "_execute_child", _no_process)],
    ids=["thread", "process"],
)
def test_a_policy_is_not_blamed_for_what_the_harness_does_not_get(
    launch: Launch,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    made: type,
    method: str,
    refused: Callable[..., None],
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    process, kept = launch("class P(Base): pass"), set(Path("/proc/self/fd").iterdir())
    folders = set((tmp_path / "temporary").iterdir())
    with monkeypatch.context() as patch:
        patch.setattr(made, method, refused)
        with pytest.raises(ExhaustedError, match="the policy's process could not be started: "):
            process.start()
    assert len(set(Path("/proc/self/fd").iterdir())) == len(kept)
    assert set((tmp_path / "temporary").iterdir()) == folders
    process.close()


def test_a_traceback_is_the_policys_own(launch: Launch) -> None:
    """Neither what called the policy nor what refused its value says where its mistake is."""
    source = """
    class P(Base):
        def act(self, observation):
            try:
                PolicyCard(name="x", control_hz=-1)
            except Exception as error:
                raise ValueError("no card") from error
    """
    shown = str(_failure(launch(source), at="act"))
    assert [line for line in shown.splitlines() if "File" in line and "under_test.py" not in line] == []
    assert shown.count("under_test.py") == 2
    assert "control_hz" in shown
    broken = str(_failure(launch("import no_such_library"), at="start"))
    assert [line for line in broken.splitlines() if "File" in line and "under_test.py" not in line] == []
    assert 'under_test.py", line 13, in <module>\n    import no_such_library\nModuleNotFoundError' in broken


@either
def test_a_policy_that_does_not_read_is_killed(launch: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message does not fit into the socket's buffers: the send itself would block for ever."""
    monkeypatch.setattr("carecontact.serving.process.STACK_PATIENCE_S", 0.2)
    process = launch(
        """
        import threading
        class P(Base):
            def act(self, observation):
                threading.Timer(0.1, os.kill, (os.getpid(), 19)).start()
                return Action()
        """,
        deadline_s=0.3,
    )
    _begun(process, acts=1)
    stopped = Path(f"/proc/{_children(_children()[0])[-1]}/stat")
    assert _soon(lambda: stopped.read_text().rpartition(")")[2].split()[0] == "T")
    with pytest.raises(PolicyError, match=r"did not read its message within 0\.(3|29\d*) s") as caught:
        process.act(synthetic_observation(cameras={"overhead": synthetic_view(height=800, width=1600)}))
    assert caught.value.kind == "timeout"


def test_a_silent_policy_is_reported_until_it_answers(launch: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.serving.conversation.WAIT_REPORT_S", 0.1)
    process = launch("class P(Base):\n    def act(self, o): time.sleep(0.35); return Action()")
    lines: list[str] = []
    _begun(process)
    process.on_wait = lines.append
    process.act(synthetic_observation())
    count = len(lines)
    assert count >= 1
    assert all(re.fullmatch(r"waiting for the policy: \d of 20 s", line) for line in lines)
    time.sleep(0.2)
    assert len(lines) == count


def test_many_slow_calls_use_up_the_budget_of_a_trial(launch: Launch) -> None:
    """Each is within its deadline; without a budget a trial would end by the supervisor's limit."""
    process = launch("class P(Base):\n    def act(self, o): time.sleep(0.1); return Action()")
    _begun(process)
    # From here on: how long a process takes to start is the machine's affair.
    process._left_s = 0.5

    def many() -> None:
        for _ in range(12):
            process.act(synthetic_observation())

    with pytest.raises(
        PolicyError, match=r"failed at act: took more than 3600 s of wall time in all its calls"
    ) as caught:
        many()
    assert caught.value.kind == "timeout"


@either
@pytest.mark.parametrize("environment", ["os.environ", "{}"], ids=["that of a policy that ends", "without variables"])
def test_a_process_in_a_session_of_its_own_is_killed(launch: Launch, tmp_path: Path, environment: str) -> None:
    process = launch(
        f"""
        import subprocess
        class P(Base):
            def act(self, observation):
                if observation.sim_time_s == 0:
                    sleeper = [sys.executable, "-c", "import time; time.sleep(60)"]
                    child = subprocess.Popen(sleeper, env=dict({environment}), start_new_session=True)
                    with open(os.path.join(os.path.dirname(__file__), "pid"), "w") as note:
                        note.write(f"{{child.pid}} {{{NAMESPACE}}}")
                    return Action()
                {"os._exit(3)" if environment == "os.environ" else "time.sleep(60)"}
        """,
        deadline_s=0.3 if environment == "{}" else 20.0,
    )
    _begun(process, acts=1)
    pid, namespace = (tmp_path / "pid").read_text().split()
    child = pid_here(int(pid), namespace)
    assert alive(child)
    with pytest.raises(PolicyError) as caught:
        process.act(synthetic_observation(sim_time_s=0.1))
    assert caught.value.kind == ("timeout" if environment == "{}" else "died")
    assert _soon(lambda: not alive(child))


@either
def test_a_hanging_import_is_killed(launch: Launch) -> None:
    error = _failure(launch("print('loading', flush=True)\ntime.sleep(60)", first_deadline_s=1.5), at="start")
    assert error.kind == "timeout"
    assert "loading" in str(error)


@either
def test_a_policy_that_will_not_end_is_killed(launch: Launch) -> None:
    process = launch(
        """
        import threading
        threading.Thread(target=time.sleep, args=(60,)).start()
        class P(Base): pass
        """
    )
    process.start()
    process.close()


def test_harness_mistakes_are_not_the_policys(launch: Launch) -> None:
    process = launch("class P(Base): pass")
    _begun(process)
    with pytest.raises(ObservationError, match=r"joint_velocity: .*'joints': 3"):
        process.act(dataclasses.replace(synthetic_observation(), joint_position=np.zeros(3)))


@either
def test_what_reaches_the_process(launch: Launch, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No variable of the harness but the named ones, no module of the world."""
    monkeypatch.setenv("CARECONTACT_SEED", "3")
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    monkeypatch.setenv("OPENAI_API_KEY", "k")
    process = launch(
        """
        import json
        class P(Base):
            def act(self, observation):
                found = {"env": dict(os.environ), "modules": sorted(sys.modules), "path": sys.path}
                with open(os.path.join(os.path.dirname(__file__), "found"), "w") as file:
                    json.dump(found, file)
                return Action()
        """
    )
    _begun(process, acts=1)
    found = json.loads((tmp_path / "found").read_text())
    assert found["env"]["PYTHONHASHSEED"] == "0"
    assert not found["env"].keys() & {"CARECONTACT_SEED", "PYTHONPATH", "OPENAI_API_KEY"}
    assert found["path"][0] == str(tmp_path)
    assert not {"", "/nowhere"} & set(found["path"])
    assert "carecontact.interface.observation" in found["modules"]
    heavy = {"mujoco", "pydantic", "scipy", "ai_edge_litert", "carecontact.recording", "carecontact.protocol"}
    assert not heavy & set(found["modules"])


@either
def test_only_the_harness_reaches_the_policy(launch: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first to connect would have it: a policy of another run could make every trial of this one fail."""
    process, found = launch("class P(Base): pass"), list[int]()
    launched = process._launch

    def spied(left: Callable[[], float]) -> int:
        port = launched(left)
        with connect(f"ws://127.0.0.1:{port}") as other, pytest.raises(ConnectionClosed):
            other.recv(timeout=20)
        found.append(port)
        return port

    monkeypatch.setattr(process, "_launch", spied)
    assert process.start().name == "under-test"
    process.reset("touch", SESSION)
    process.act(synthetic_observation())
    assert found


@pytest.mark.parametrize(("language", "reaches"), [("live:m-1", True), ("rules-v1", False), (None, False)])
def test_the_key_of_a_language_model_reaches_a_policy_that_shall_use_one(
    launch: Launch, language: str | None, reaches: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every policy may open connections, and so could spend what the key pays."""
    monkeypatch.setenv("OPENAI_API_KEY", "k")
    source = """
        class P(Base):
            def __init__(self, *, language: str = "none"):
                print("key" if "OPENAI_API_KEY" in os.environ else "no key")
    """
    with launch(source, language=language) as process:
        process.start()
    assert process.printed == ("key" if reaches else "no key")


def test_arguments_and_variables_reach_the_constructor_and_the_card(launch: Launch, tmp_path: Path) -> None:
    source = """
        class P(Base):
            def __init__(self, *, steps: int, language: str = "none", record: str = ""):
                print(repr(steps), language, record, os.environ["TOKEN"], sys.orig_argv)
    """
    given = {"arguments": {"steps": "3"}, "environment": {"TOKEN": "s-4"}, "record": str(tmp_path / "record-6")}
    with launch(source, language="live:model-5", **given) as process:
        card = process.start()
    assert (card.arguments, card.environment) == ({"steps": "3"}, ("TOKEN",)), "a language has its own field"
    assert process.printed.startswith(f"3 live:model-5 {tmp_path}/record-6 s-4 [")
    command_line = process.printed.partition("[")[2]
    assert not [word for word in ("steps", "s-4", "model-5", "record-6") if word in command_line]


def test_the_values_of_variables_are_taken_out_of_what_the_policy_says(launch: Launch) -> None:
    source = """
        class P(Base):
            def reset(self, instruction):
                print("printed", os.environ["TOKEN"])
                raise ValueError("raised " + os.environ["TOKEN"])
    """
    error = _failure(launch(source, environment={"TOKEN": "sekret-4"}), at="reset")
    assert re.search(r"raised \[secret removed\](.|\n)*printed \[secret removed\]", str(error))
    assert "sekret-4" not in str(error)


def test_a_variable_that_does_not_pass_is_named(launch: Launch, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOKEN", "sekret-4")
    error = _failure(launch("class P(Base):\n    key = os.environ['TOKEN']\n"), at="start")
    assert re.search(r"KeyError: 'TOKEN'; TOKEN is set here, .* --policy-env TOKEN", str(error))
    assert "sekret-4" not in str(error)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({}, "it requires the argument 'steps'"),
        ({"steps": "x"}, "argument 'steps': expected int, got 'x'"),
        ({"stops": "1"}, r"it has no argument 'stops'; its arguments: steps: int \(required\)"),
    ],
)
def test_a_wrong_argument_is_reported_without_a_traceback(launch: Launch, arguments: dict[str, str], says: str) -> None:
    source = "class P(Base):\n    def __init__(self, steps: int): ..."
    error = _failure(launch(source, arguments=arguments), at="start")
    assert error.kind == "argument"
    assert re.search(says, str(error))
    assert "Traceback" not in str(error)


def test_a_policy_can_refuse_the_value_of_an_argument_without_a_traceback(launch: Launch) -> None:
    source = (
        "from carecontact.errors import ConfigError\n"
        "class P(Base):\n"
        "    def __init__(self, donor: str):\n"
        "        raise ConfigError(f'donor {donor}: no such file')\n"
    )
    error = _failure(launch(source, arguments={"donor": "nothing.npz"}), at="start")
    assert (error.kind, str(error).endswith("donor nothing.npz: no such file")) == ("argument", True)
    assert "Traceback" not in str(error)


def test_output_is_kept(launch: Launch) -> None:
    process = launch("class P(Base):\n    def reset(self, i): print('heard', i)")
    _begun(process)
    process.close()
    assert process.printed == "heard touch"


@either
@pytest.mark.parametrize("hangs", ["time.sleep(60)", "os.kill(os.getpid(), 19)"], ids=["sleeps", "stopped"])
def test_the_process_ends_with_its_parent(tmp_path: Path, hangs: str) -> None:
    """The parent dies without a word while the policy hangs."""
    (tmp_path / "orphan.py").write_text(
        PREAMBLE
        + f"class P(Base):\n    def reset(self, i):\n        print(os.getpid(), {NAMESPACE}, file=open('pid', 'w'))\n"
        + f"        os.rename('pid', 'born'); {hangs}\n"
    )
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys; sys.path[:0] = sys.argv[1:]\n"
            "from carecontact.serving.process import PolicyProcess\n"
            "from synthetic import SESSION\n"
            "from carecontact.serving.conversation import PolicySetup\n"
            "from carecontact.interface.policy import PolicyRef\n"
            "setup = PolicySetup(ref=PolicyRef.parse('orphan:P'), search_path=('.',), writable=('.',))\n"
            "p = PolicyProcess(setup, first_deadline_s=60, deadline_s=60)\n"
            "p.start(); p.reset('touch', SESSION)",
            str(Path(carecontact.__file__).parents[1]),
            str(Path(synthetic.__file__).parent),
        ],
        cwd=tmp_path,
    )
    born = tmp_path / "born"
    assert _soon(born.exists)
    written, namespace = born.read_text().split()
    pid = pid_here(int(written), namespace)
    assert alive(pid)
    if hangs != "time.sleep(60)":
        assert _soon(lambda: Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")
    parent.kill()
    parent.wait()
    assert _soon(lambda: not alive(pid))


def _soon(condition: Callable[[], bool]) -> bool:
    for _ in range(400):
        if condition():
            return True
        time.sleep(0.05)
    return False


@either
@pytest.mark.parametrize("where", ["server.serve_forever", "thread"])
def test_a_policy_whose_server_gets_no_thread_is_not_blamed_at_once(
    launch: Launch, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """Others may have taken them; this ends as the kernel ends a process without memory."""
    refuse = 'import threading\ndef refused(self): raise RuntimeError("can\'t start new thread")\n'
    at = "threading.Thread.start = refused\n"
    if where != "thread":
        at = "from websockets.sync.server import Server\nServer.serve_forever = refused\n"
    monkeypatch.setattr(
        harness_process,
        "_BOOTSTRAP",
        harness_process._BOOTSTRAP.replace("main(options)", f"{refuse}{at}main(options)"),  # pyright: ignore[reportPrivateUsage]
    )
    process = launch("class P(Base): pass", first_deadline_s=5.0)
    with pytest.raises(PolicyError, match="can't start new thread") as failure:
        process.start()
    assert failure.value.kind == "killed"
