"""Client against server in one process: what each end says of the other's mistakes."""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from queue import SimpleQueue

import msgpack
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection

from carecontact.errors import ActionError, PolicyError
from carecontact.interface.action import Action
from carecontact.interface.action_spaces import check_action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.serving import client, server
from carecontact.serving.client import PolicyClient
from carecontact.serving.connection import Connection
from carecontact.serving.packing import MAX_REPLY_BYTES, pack
from tests.policies.synthetic import BOUNDS, SESSION, synthetic_observation
from tests.serving.fuzz import LAYERS, replies, spoilt, spoilt_transport


class Answers:
    card = PolicyCard(name="answers")

    def __init__(self, answer: object = None) -> None:
        self.answer = answer
        self.heard: list[str] = []

    def reset(self, instruction: str) -> None:
        self.heard.append(instruction)

    def act(self, observation: Observation) -> Action:
        return self.answer


Meet = Callable[[Answers], PolicyClient]


@pytest.fixture
def meet() -> Iterator[Meet]:
    """A client that has seen the card and reset the policy it is given."""
    threads: list[threading.Thread] = []
    clients: list[PolicyClient] = []

    def start(policy: Answers) -> PolicyClient:
        port: SimpleQueue[int] = SimpleQueue()
        thread = threading.Thread(target=server.serve_policy, args=(policy,), kwargs={"on_port": port.put})
        thread.start()
        threads.append(thread)
        clients.append(PolicyClient(Connection.open(port=port.get(timeout=20), deadline_s=20)))
        clients[-1].card(deadline_s=20)
        clients[-1].reset("touch", SESSION, deadline_s=20)
        return clients[-1]

    yield start
    for one in clients:
        one.say_goodbye(deadline_s=20)
        one.connection.close()
    for thread in threads:
        thread.join(20)
        assert not thread.is_alive()


POSE = synthetic_observation().pose_tcp_in_base


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ("left", "expected an Action or a list of Actions, got str 'left'"),
        (Action(done=1), r"^actions\[0\]\.done: expected True or False, got int 1"),
        ([Action(), Action(stiffness=(5000,))], r"^actions\[1\]\.stiffness: expected \(translational, rotational\)"),
    ],
)
def test_an_answer_that_is_no_action(meet: Meet, answer: object, says: str) -> None:
    with pytest.raises(PolicyError, match=says) as caught:
        meet(Answers(answer)).act(synthetic_observation(), deadline_s=20)
    assert caught.value.kind == "action"


def test_values_are_left_to_the_episode(meet: Meet) -> None:
    far = POSE + [9, 0, 0, 0, 0, 0, np.nan]
    (action,) = meet(Answers(Action(pose_tcp_in_base=far))).act(synthetic_observation(), deadline_s=20).actions
    np.testing.assert_array_equal(action.pose_tcp_in_base, far)


@pytest.mark.parametrize(
    ("reply", "kind", "says"),
    [
        (b"\xc1 not msgpack", "garbage", "expected msgpack"),
        (b"", "garbage", "expected msgpack, got 0 bytes"),
        ("text", "garbage", "expected a binary message, got text 'text'; send .*msgpack"),
        (pack({"type": "ready"}), "garbage", "expected one 'actions' message, got type 'ready'; missing actions; send"),
        (pack([1, 2]), "garbage", r"got \[1, 2\]; send .*pose_tcp_in_base"),
        (msgpack.packb({b"actions": 1}), "garbage", "got b.actions.; pack text and not bytes as keys"),
        (pack({"type": "actions", "actions": [], "score": 1}), "garbage", "unknown key score; send"),
        (bytes(MAX_REPLY_BYTES + 1), "oversize", "at most 4194304 bytes"),
        (pack({"type": "actions", "actions": [{"torque": 1}]}), "action", "unknown key torque; valid: pose_tcp"),
        (pack({"type": "actions", "actions": []}), "action", "expected 1 to 2000 actions, got 0"),
        (pack({"type": "error", "kind": "exception", "message": "why"}), "exception", "^why$"),
        (pack({"type": "error", "kind": "invented", "message": "why"}), "exception", "^why$"),
        (pack({"type": "error", "kind": "died", "message": "why"}), "exception", "^why$"),
        (pack({"type": "error", "kind": "program", "message": "why"}), "program", "^why$"),
        (pack({"type": "error"}), "exception", "expected its reason as text, got None"),
        (pack({"type": "error", "kind": [], "message": " "}), "exception", "expected its reason as text, got ' '"),
    ],
)
def test_a_reply_that_is_no_answer(
    meet: Meet, monkeypatch: pytest.MonkeyPatch, reply: bytes | str, kind: str, says: str
) -> None:
    one = meet(Answers(Action()))
    monkeypatch.setattr(server, "pack", lambda message: reply)
    with pytest.raises(PolicyError, match=says) as caught:
        one.act(synthetic_observation(), deadline_s=20)
    assert caught.value.kind == kind


@pytest.mark.parametrize(
    ("message", "says"),
    [
        ({"type": "reset", "instruction": "touch", "session": {}, "seed": 3}, r"got type 'reset' with .*'seed'"),
        ({"type": "act"}, r"got type 'act' with \[\]"),
        ({"type": "step"}, "expected a reset, act or close message, got type 'step'"),
        ([], "got type None"),
    ],
)
def test_a_request_that_the_server_does_not_know(
    meet: Meet, monkeypatch: pytest.MonkeyPatch, message: object, says: str
) -> None:
    one = meet(Answers(Action()))
    monkeypatch.setattr(client, "act_message", lambda _: pack(message))
    with pytest.raises(PolicyError, match=says):
        one.act(synthetic_observation(), deadline_s=20)


def test_a_second_answer_is_not_taken_for_the_next_one(meet: Meet, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be counted for an observation that the policy had not seen when it answered."""
    one, send = meet(Answers(Action())), ServerConnection.send
    twice = threading.Event()

    def send_twice(self: ServerConnection, message: bytes) -> None:
        send(self, message)
        send(self, message)
        twice.set()

    monkeypatch.setattr(ServerConnection, "send", send_twice)
    one.act(synthetic_observation(), deadline_s=20)
    assert twice.wait(20)
    # The second one has left the other end; once it is here it is seen.
    waiting = one.connection._websocket.recv_messages.frames
    assert any(waiting.qsize() or time.sleep(0.01) for _ in range(2000))
    with pytest.raises(PolicyError, match="expected no message before the next request, got one of") as caught:
        one.act(synthetic_observation(), deadline_s=20)
    assert caught.value.kind == "garbage"


SAMPLE = 10
"""Spoilt frames of each layer that travel over a real WebSocket on the loopback; test_fuzz.py has ten thousand more."""


@pytest.mark.parametrize("layer", LAYERS)
def test_spoilt_frames_over_the_real_line(meet: Meet, monkeypatch: pytest.MonkeyPatch, layer: str) -> None:
    """Each is a PolicyError that says why, or an answer within the contract; never anything else."""
    rng, refused = random.Random(f"line {layer}"), 0
    message = replies()["actions"]
    for _ in range(SAMPLE):
        with monkeypatch.context() as patch:
            one = meet(Answers(Action()))
            if layer == "transport":
                raw = spoilt_transport(pack(message), rng)

                def scribble(self: ServerConnection, data: bytes, raw: bytes = raw) -> None:
                    with contextlib.suppress(OSError):  # the client hangs up at the first byte that it cannot take
                        self.socket.sendall(raw)
                        self.socket.shutdown(socket.SHUT_WR)

                patch.setattr(ServerConnection, "send", scribble)
            else:
                data = spoilt(message, layer, rng)
                patch.setattr(server, "pack", lambda _, data=data: data)
            answer = _answer_of(one)
            if isinstance(answer, PolicyError):
                refused += 1
                assert answer.kind not in ("timeout", "start")
                assert str(answer)
            else:
                try:
                    assert all(check_action(action, BOUNDS) for action in answer)
                except ActionError:
                    refused += 1
    assert refused >= SAMPLE // 2


def _answer_of(one: PolicyClient) -> list[Action] | PolicyError:
    try:
        return one.act(synthetic_observation(), deadline_s=20).actions
    except PolicyError as error:
        return error


@pytest.mark.parametrize(
    "frame",
    [
        b"\xff\x00not a frame of any kind",
        b"\x82\x85masked bytes from a server",
        b"\x82\x7f" + b"\xff" * 8,
        b"\x80\x01x",
        b"\x81\x02\xff\xfe",
    ],
)
def test_bytes_that_are_no_websocket(monkeypatch: pytest.MonkeyPatch, frame: bytes) -> None:
    def scribble(_: object, connection: ServerConnection, *given: object) -> None:
        connection.socket.sendall(frame)
        written.set()
        with contextlib.suppress(ConnectionClosed):
            connection.recv(timeout=20)

    written = threading.Event()
    monkeypatch.setattr(server, "converse", scribble)
    port: SimpleQueue[int] = SimpleQueue()
    thread = threading.Thread(target=server.serve_policy, args=(Answers(),), kwargs={"on_port": port.put})
    thread.start()
    one = PolicyClient(Connection.open(port=port.get(timeout=20), deadline_s=20))
    assert written.wait(20)
    with pytest.raises(PolicyError) as caught:
        one.card(deadline_s=20)
    one.connection.close()
    thread.join()
    assert caught.value.kind in ("garbage", "oversize")


def test_a_client_that_is_gone_at_once_is_no_failure_of_the_server(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def gone(_: object) -> None:
        raise OSError("Transport endpoint is not connected")

    port: SimpleQueue[int] = SimpleQueue()
    thread = threading.Thread(target=server.serve_policy, args=(Answers(),), kwargs={"on_port": port.put})
    thread.start()
    at = port.get(timeout=20)
    with monkeypatch.context() as patch:
        patch.setattr(ServerConnection, "remote_address", property(gone))
        with pytest.raises(PolicyError):
            PolicyClient(Connection.open(port=at, deadline_s=20)).card(deadline_s=20)
    one = PolicyClient(Connection.open(port=at, deadline_s=20))
    one.card(deadline_s=20)
    one.say_goodbye(deadline_s=20)
    one.connection.close()
    thread.join(20)
    assert not thread.is_alive()
    assert not [record for record in caplog.records if record.exc_info]
