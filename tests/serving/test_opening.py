"""A policy named by its address: served from another process, and what stands there when it is no policy."""

from __future__ import annotations

import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from websockets.http11 import Response
from websockets.sync.server import ServerConnection, basic_auth, serve

from carecontact.errors import LostError, PolicyError, UnreachableError
from carecontact.interface.action import Action
from carecontact.interface.observation import CameraView
from carecontact.interface.policy import PolicyCard
from carecontact.serving import codec
from carecontact.serving.codec import act_message
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import RemotePolicy, open_policy
from carecontact.serving.packing import MAX_REPLY_BYTES, pack, unpack
from carecontact.serving.process import PolicyProcess
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.serving.served import served

POLICY = """
class P(Base):
    card = PolicyCard(name="far")
    def reset(self, instruction):
        self.instruction, self.calls = instruction, 0
    def act(self, observation):
        self.calls += 1
        if self.instruction == "die":
            print("last words")
            os._exit(3)
        if self.instruction == "hang":
            time.sleep(600)
        return Action(stiffness=(100.0 + self.calls, 20.0), done=True)
"""

Start = Callable[..., RemotePolicy]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    with served(POLICY, tmp_path_factory.mktemp("far")) as running:
        yield running


def at(port: int, *, first_deadline_s: float = 20.0, deadline_s: float = 20.0) -> RemotePolicy:
    return RemotePolicy(
        PolicySetup.of(f"ws://127.0.0.1:{port}"), first_deadline_s=first_deadline_s, deadline_s=deadline_s
    )


def failure(policy: RemotePolicy, *, instruction: str = "touch") -> PolicyError:
    """A policy that hangs has half a second for its answer, and 20 s to load."""

    def converse() -> None:
        with policy:
            policy.start()
            policy.reset(instruction, SESSION)
            if instruction == "hang":
                policy._first_deadline_s = 0.5
            policy.act(synthetic_observation())

    with pytest.raises(PolicyError) as caught:
        converse()
    assert str(caught.value).startswith(f"policy '{policy.policy}' failed at ")
    return caught.value


def test_two_trials_at_once_have_a_policy_each(server: tuple[int, subprocess.Popen[str]]) -> None:
    with at(server[0]) as one, at(server[0]) as other:
        for policy in (one, other):
            assert policy.start() == PolicyCard(name="far")
            policy.reset("touch", SESSION)
        stiffness = [policy.act(synthetic_observation()).actions[0].stiffness for policy in (one, one, other)]
    assert stiffness == [(101.0, 20.0), (102.0, 20.0), (101.0, 20.0)]
    with pytest.raises(RuntimeError, match="nothing after a failure or close"):
        one.act(synthetic_observation())


def test_a_policy_that_dies_has_failed_as_a_local_one(server: tuple[int, subprocess.Popen[str]]) -> None:
    error = failure(at(server[0]), instruction="die")
    assert error.kind == "died"
    assert "closed without an answer" in str(error)


def test_a_policy_that_hangs_ends_with_its_trial_and_the_server_says_where(tmp_path: Path) -> None:
    """Else it would keep its place, and its graphics card, for ever. The trial's host cannot know where it hung."""
    with served(POLICY, tmp_path) as (port, process):
        error = failure(at(port), instruction="hang")
        assert process.stdout is not None
        begins, ended, here, frame = [process.stdout.readline() for _ in range(4)]
        deadline = time.monotonic() + 20
        while _children(process.pid) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert _children(process.pid) == []
    assert error.kind == "timeout"
    assert "no actions message within 0.5 s" in str(error)
    assert begins.endswith(": a trial begins\n")
    assert ended.endswith(": the trial has ended\n")
    assert here == "it hung here (most recent call last):\n"
    assert frame.endswith('under_test.py", line 24, in act\n')


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task")
    if not tasks.is_dir():
        pytest.skip("lists child processes through /proc")
    found: list[int] = []
    for task in tasks.iterdir():
        # A thread may end between the listing and the reading.
        with suppress(FileNotFoundError, ProcessLookupError):
            found += map(int, (task / "children").read_text().split())
    return found


def test_nothing_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    error = failure(at(port))
    assert error.kind == "start"
    assert f"nothing listens at 127.0.0.1:{port}; start the policy's server there first" in str(error)


def test_a_trial_waits_for_a_server_that_is_not_there_yet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(UnreachableError, match=f"failed at start: nothing listens at 127.0.0.1:{port}"):
        at(port).start()
    pauses, lines = list[float](), list[str]()
    with ExitStack() as stack:

        def sleep(pause_s: float) -> None:
            pauses.append(pause_s)
            if len(pauses) == 6:
                stack.enter_context(served("class P(Base): pass", tmp_path, port=port))

        monkeypatch.setattr("carecontact.serving.opening.time", SimpleNamespace(sleep=sleep))
        with at(port, first_deadline_s=60) as policy:
            policy.on_wait, policy.patient = lines.append, True
            assert policy.start() == PolicyCard(name="under-test")
    assert pauses == [0.5, 1, 2, 4, 5, 5]
    assert len(lines) == 1
    assert lines[0].startswith(f"nothing listens at 127.0.0.1:{port}; start the policy's server there first; trying ")


def test_a_trial_waits_no_longer_than_its_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    policy = at(port, first_deadline_s=0.6)
    policy.patient = True
    with pytest.raises(UnreachableError, match="nothing listens"):
        policy.start()


STAGES = ("handshake", "proxy", "card", "reset", "act", "second act")


@contextmanager
def losing(stage: str, times: int, *, name: str = "far") -> Iterator[tuple[int, list[str]]]:
    """A port where that many connections are lost at a stage, and what those behind it were asked. A connection that
    comes later is shown a card of that name."""
    asked: list[str] = []
    lost = 0

    def converse(connection: ServerConnection) -> None:
        nonlocal lost

        def at_stage(now: str) -> bool:
            nonlocal lost
            asked.append(now)
            if now != stage or lost == times:
                return False
            lost += 1
            connection.socket.shutdown(socket.SHUT_RDWR)
            return True

        card = PolicyCard(name=name if lost else "far")
        acts = 0
        if at_stage("card"):
            return
        connection.send(pack({"type": "card", "card": codec.encode_card(card)}))
        for frame in connection:
            kind = str(cast(dict[str, object], unpack(cast(bytes, frame)))["type"])
            acts += kind == "act"
            if kind == "close" or at_stage("second act" if acts == 2 else kind):
                return
            answer = codec.encode_actions([Action(done=True)])
            connection.send(pack({"type": "ready"} if kind == "reset" else {"type": "actions", "actions": answer}))

    def before(connection: ServerConnection, request: object) -> Response | None:
        nonlocal lost
        if stage not in STAGES[:2] or lost == times:
            return None
        lost += 1
        if stage == "proxy":
            return connection.respond(503, "no server")
        connection.socket.shutdown(socket.SHUT_RDWR)
        return None

    with speaking(converse, process_request=before) as port:
        yield port, asked


@pytest.fixture
def no_pause(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    pauses: list[float] = []
    monkeypatch.setattr("carecontact.serving.opening.time", SimpleNamespace(sleep=pauses.append))
    return pauses


def trial(port: int) -> None:
    with at(port) as policy:
        policy.patient = True
        policy.start()
        policy.reset("touch", SESSION)
        for _ in range(2):
            policy.act(synthetic_observation())


@pytest.mark.parametrize("stage", STAGES[:-1])
def test_a_trial_whose_connection_is_lost_before_its_first_action_begins_again(
    stage: str, no_pause: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("CRITICAL", "websockets")
    with losing(stage, 2) as (port, asked):
        trial(port)
    assert no_pause == [0.5, 1]
    until = ["card", "reset", "act"][: max(STAGES.index(stage) - 1, 0)]
    assert asked == [*until, *until, "card", "reset", "act", "second act"]


@pytest.mark.parametrize(("stage", "times"), [("card", 3), ("reset", 3), ("act", 3), ("second act", 1)])
def test_a_policy_that_loses_every_connection_or_one_after_its_first_action_has_failed(
    stage: str, times: int, no_pause: list[float]
) -> None:
    with losing(stage, 9) as (port, asked), pytest.raises(LostError, match="closed without an answer"):
        trial(port)
    assert asked.count(stage) == times
    assert len(no_pause) == times - 1


def test_a_server_that_loses_a_trial_and_stays_away_is_unreachable(tmp_path: Path, no_pause: list[float]) -> None:
    with served(POLICY, tmp_path) as (port, server), at(port, first_deadline_s=3) as policy:
        policy.patient = True
        policy.start()
        server.kill()
        server.wait()
        with pytest.raises(UnreachableError, match="nothing listens"):
            policy.reset("touch", SESSION)


@pytest.mark.usefixtures("no_pause")
def test_a_server_that_comes_back_as_another_policy_is_refused() -> None:
    with losing("act", 1, name="other") as (port, _), pytest.raises(PolicyError, match="another card") as caught:
        trial(port)
    assert caught.value.kind == "handshake"


def test_a_host_that_there_is_not() -> None:
    error = failure(RemotePolicy(PolicySetup.of("ws://no-such-host.invalid:1"), first_deadline_s=20, deadline_s=20))
    assert isinstance(error, UnreachableError)
    assert error.kind in ("start", "timeout")
    assert "no-such-host.invalid:1" in str(error)


@contextmanager
def listening(answer: bytes) -> Iterator[int]:
    """A port that takes a connection, says this and closes it, or says nothing and keeps it open."""
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def speak() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(answer)
                if not answer:
                    over.wait(20)

        thread = threading.Thread(target=speak)
        thread.start()
        yield listener.getsockname()[1]
        over.set()
        thread.join()


@pytest.mark.parametrize(
    ("answer", "kind", "says"),
    [
        (b"", "timeout", "no answer to the WebSocket handshake within"),
        (b"SSH-2.0-OpenSSH_9\r\n", "handshake", "the WebSocket handshake with the policy server failed"),
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", "handshake", "HTTP 404"),
    ],
)
def test_a_server_of_something_else(answer: bytes, kind: str, says: str) -> None:
    with listening(answer) as port:
        error = failure(at(port, first_deadline_s=0.5 if kind == "timeout" else 20))
    assert error.kind == kind
    assert says in str(error)


@contextmanager
def speaking(converse: Callable[[ServerConnection], object], **options: object) -> Iterator[int]:
    """A WebSocket server that is no policy's."""
    with serve(converse, "127.0.0.1", 0, **options) as running:  # pyright: ignore[reportArgumentType]
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running.socket.getsockname()[1]
        running.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("message", "kind", "says"),
    [
        (pack({"action_horizon": 10}), "garbage", "type None; unknown key action_horizon; missing card, type; send"),
        ("hello", "garbage", "expected a binary message, got text 'hello'; send"),
        (bytes(MAX_REPLY_BYTES + 1), "oversize", "at most 4194304 bytes"),
        (None, "timeout", "no card message within"),
    ],
)
def test_a_websocket_that_speaks_another_dialect(message: bytes | str | None, kind: str, says: str) -> None:
    def converse(connection: ServerConnection) -> None:
        if message is not None:
            connection.send(message)
        for _ in connection:
            pass

    with speaking(converse) as port:
        error = failure(at(port, first_deadline_s=0.5 if message is None else 20))
    assert error.kind == kind
    assert says in str(error)


def test_credentials_reach_the_server_and_no_message() -> None:
    card = pack({"type": "card", "card": codec.encode_card(PolicyCard(name="guarded"))})
    guard = basic_auth(realm="policy", credentials=("user", "pass/word"))
    with speaking(lambda connection: connection.send(card), process_request=guard) as port:
        known = PolicySetup.of(f"ws://user:pass%2Fword@127.0.0.1:{port}")
        with open_policy(known, first_deadline_s=20, deadline_s=20) as policy:
            assert policy.start().name == "guarded"
        error = failure(at(port))
        wrong = failure(
            RemotePolicy(PolicySetup.of(f"ws://user:secret@127.0.0.1:{port}"), first_deadline_s=20, deadline_s=20)
        )
    assert error.kind == wrong.kind == "handshake"
    assert "HTTP 401" in str(error)
    assert "secret" not in str(wrong)


def test_a_name_or_class_still_runs_here() -> None:
    for policy in ("hover", "my_policy:Mine"):
        assert isinstance(open_policy(PolicySetup.of(policy), first_deadline_s=1, deadline_s=1), PolicyProcess)


def test_an_observation_arrives_whole(tmp_path: Path) -> None:
    """The relay cuts messages where it likes: nothing may be lost or turned round."""
    source = """
    class P(Base):
        card = PolicyCard(name="sums", modalities=("rgb",))
        def act(self, observation):
            rgb = observation.cameras["overhead"].rgb
            total = float((rgb.astype(np.int64).ravel() * (np.arange(rgb.size) % 997)).sum() % 899)
            return Action(stiffness=(100.0 + total, 20.0))
    """
    rgb = np.random.default_rng(0).integers(0, 255, (960, 1280, 3), np.uint8)
    expected = 100.0 + float((rgb.astype(np.int64).ravel() * (np.arange(rgb.size) % 997)).sum() % 899)
    view = CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=rgb)
    with served(source, tmp_path) as (port, _), at(port) as policy:
        policy.start()
        policy.reset("touch", SESSION)
        reply = policy.act(synthetic_observation(cameras={"overhead": view}))
    assert reply.actions[0].stiffness == (expected, 20.0)


@pytest.mark.parametrize(
    ("end", "kind", "says"),
    [
        ("raise", "died", "raised an exception (close code 1011): see its own output"),
        ("return", "died", "closed the connection without an answer (close code 1000)"),
        ("1001", "died", "closed the connection without an answer (close code 1001)"),
        ("1012", "died", "closed the connection without an answer (close code 1012)"),
        ("small", "oversize", "refused a message of {} bytes (close code 1009): raise its limit"),
    ],
)
def test_how_a_server_closed_the_connection_is_known_by_its_code(
    end: str, kind: str, says: str, caplog: pytest.LogCaptureFixture
) -> None:
    def converse(connection: ServerConnection) -> None:
        connection.send(pack({"type": "card", "card": {"name": "short"}}))
        connection.recv()
        if end == "raise":
            raise ValueError("a bug")
        if end.isdecimal():
            connection.close(int(end))
        if end == "small":
            connection.send(pack({"type": "ready"}))
            connection.recv()

    caplog.set_level("CRITICAL", "websockets")
    observation = synthetic_observation(cameras={"overhead": synthetic_view(height=600, width=800)})
    with speaking(converse) as port, at(port) as policy:
        policy.start()
        if end == "small":
            policy.reset("touch", SESSION)
        with pytest.raises(PolicyError) as caught:
            policy.act(observation) if end == "small" else policy.reset("touch", SESSION)
    assert caught.value.kind == kind
    assert says.format(len(act_message(observation))) in str(caught.value)
    assert isinstance(caught.value, LostError) is end.isdecimal(), "who goes away or restarts has not failed yet"
