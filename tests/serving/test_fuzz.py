"""Ten thousand spoilt frames at the harness's own client and the policy's own server: none crashes, hangs or slips in.

FRAMES says how many at each layer; 1,000 well-formed ones are mixed in, and each is understood as it was meant,
whatever came before it. The fast suite sends a fifth of them, the slow one all.
"""

from __future__ import annotations

import json
import random
import socket
import subprocess
import sys
import threading
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable

import pytest
from websockets.client import ClientProtocol
from websockets.protocol import State
from websockets.sync.client import ClientConnection
from websockets.uri import parse_uri

from carecontact.errors import ContractError, PolicyError
from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.observation import LastViews, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.serving.client import Client, PolicyClient
from carecontact.serving.connection import Connection, Deadline
from carecontact.serving.packing import MAX_REPLY_BYTES, pack
from carecontact.serving.server import _answer
from tests.policies.synthetic import SESSION, synthetic_observation
from tests.serving.fuzz import LAYERS, Plain, framed, replies, requests, spoilt, spoilt_transport
from tests.serving.hostile import STAGES, attacks_at, hostile_server
from tests.serving.hostile_client import DEADLINE_S, meet

FRAMES = {"transport": 1200, "msgpack": 1800, "schema": 1800, "dtype": 1800, "shape": 1700, "value": 1700}
WELL_FORMED = 1000
TO_THE_POLICY = 0.2
"""Share of the frames above the transport that go the other way."""
SLOWEST_S = 1.0
"""Of processor time, for one frame."""
FUZZ_DEADLINE_S = 20.0
KINDS = {"actions": "act", "card": "card", "ready": "reset", "error": "act"}
OBSERVATION = synthetic_observation()


def test_ten_thousand_is_the_number() -> None:
    assert sum(FRAMES.values()) == 10_000
    assert tuple(FRAMES) == LAYERS


Heard = list[Action] | PolicyCard | PolicyError | None


class Peer:
    """A client as the harness has it, on a line whose other end the test holds."""

    unasked = True
    """Whether the other end sends its card before it is asked."""

    def __init__(self, make: Callable[[Connection], Client] = PolicyClient) -> None:
        ours, self.theirs = socket.socketpair()
        protocol = ClientProtocol(parse_uri("ws://policy"), max_size=MAX_REPLY_BYTES, state=State.OPEN)
        self.connection = ClientConnection(ours, protocol, ping_interval=None, close_timeout=0.2)
        # The handshake is over: what arrives now are frames.
        self.connection.response = object()  # pyright: ignore[reportAttributeAccessIssue]
        self.connection.pending_legacy_warning = False
        self._deadline = Deadline(ours)
        self.client = make(Connection(self.connection, self._deadline))

    def hear(self, kind: str, wire: bytes, *, last: bool) -> Heard:
        """What the harness makes of raw bytes that answer a request of that kind; the card comes unasked."""
        try:
            return self._hear(kind, wire, last=last)
        except PolicyError as error:
            return error

    def _hear(self, kind: str, wire: bytes, *, last: bool) -> Heard:

        def answer() -> None:
            self.theirs.sendall(wire)
            if last:
                self.theirs.shutdown(socket.SHUT_WR)

        def send(message: bytes, *, deadline_s: float) -> None:
            # A message may be longer than what the line holds.
            reader = threading.Thread(target=self._read, args=(len(message),), daemon=True)
            reader.start()
            Connection.send(self.client.connection, message, deadline_s=deadline_s)
            reader.join(5)
            answer()

        self.client.connection.send = send
        if kind == "card":
            if self.unasked:
                answer()
            return self.client.card(deadline_s=FUZZ_DEADLINE_S)
        if kind == "act":
            return self.client.act(OBSERVATION, deadline_s=FUZZ_DEADLINE_S).actions
        self.client.reset("touch", SESSION, deadline_s=FUZZ_DEADLINE_S)
        return None

    def _read(self, count: int) -> None:
        while count > 0 and (piece := self.theirs.recv(1 << 20)):
            count -= len(piece)

    def close(self) -> None:
        self.theirs.close()
        self._deadline.end()
        self.connection.close_socket()
        self.connection.recv_events_thread.join(5)
        assert not self.connection.recv_events_thread.is_alive()


class Silent:
    card = PolicyCard(name="silent")

    def reset(self, instruction: str) -> None: ...

    def act(self, observation: Observation) -> Action:
        return Action()


def harmless(heard: Heard) -> bool:
    """Whether what got through has the types that the wire promises; ``Episode.step`` checks the values."""
    if not isinstance(heard, list):
        return heard is None or isinstance(heard, PolicyCard)
    return 1 <= len(heard) <= MAX_CHUNK and all(
        (action.pose_tcp_in_base is None or action.pose_tcp_in_base.dtype.kind in "fiu")
        and (action.stiffness is None or [type(k) for k in action.stiffness] in ([float] * 2, [float] * 6))
        and (action.gripper is None or type(action.gripper) is float)
        and type(action.done) is bool
        for action in heard
    )


def asks(frame: bytes) -> bool:
    """Whether the policy's server refuses a request; what it does not refuse, it answers."""
    try:
        _answer(Silent(), frame, LastViews())
    except ContractError as error:
        return bool(str(error))
    return False


def on_the_wire(message: Plain, layer: str, rng: random.Random) -> bytes:
    if layer == "transport":
        return spoilt_transport(pack(message), rng)
    return framed(pack(message) if layer == "well-formed" else spoilt(message, layer, rng))


@pytest.mark.parametrize("part", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_no_frame_crashes_hangs_or_slips_in(part: int, record_property: Callable[[str, object], None]) -> None:
    rng, answers, asked = random.Random(20260101 + part), replies(), requests()
    counts = {layer: count // part for layer, count in {**FRAMES, "well-formed": WELL_FORMED}.items()}
    plan = [layer for layer, count in counts.items() for _ in range(count)]
    rng.shuffle(plan)
    seen, refused = Counter[str](), Counter[str]()
    slowest = 0.0
    peer = Peer()
    for layer in plan:
        seen[layer] += 1
        started = time.process_time()
        if layer not in ("transport", "well-formed") and rng.random() < TO_THE_POLICY:
            refused[layer] += asks(spoilt(asked[rng.choice(list(asked))], layer, rng))
        else:
            kind = rng.choice(list(answers))
            one = Peer() if layer == "transport" else peer
            heard = one.hear(KINDS[kind], on_the_wire(answers[kind], layer, rng), last=layer == "transport")
            if isinstance(heard, PolicyError):
                assert heard.kind in set(PolicyError.KINDS) - {"timeout"}
                assert str(heard)
                refused[layer] += (layer, kind) != ("well-formed", "error")
            else:
                assert harmless(heard), layer
            if layer == "well-formed" and kind == "actions":
                assert isinstance(heard, list)
                assert [a.done for a in heard] == [False, True]
                assert heard[0].stiffness == (400.0, 20.0)
            if one is not peer:
                one.close()
        slowest = max(slowest, time.process_time() - started)
    assert peer.connection.protocol.state is State.OPEN, "one line survived every message that was not understood"
    peer.close()
    assert seen == counts
    assert refused["well-formed"] == 0
    shares = {layer: round(refused[layer] / seen[layer], 2) for layer in LAYERS}
    record_property("frames", dict(seen))
    record_property("share refused", shares)
    assert all(share > 0.5 for share in shares.values()), shares
    assert slowest < SLOWEST_S


# Whatever a peer does on its line, each call ends in time, as a failure that has a name.

LATE_S, MEMORY_MB = 2.0, 256
AT_ONCE = 24
"""Most of the attacks wait for a deadline, so that many can be met at the same time."""


@pytest.mark.parametrize("times", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_every_call_ends_in_time_and_names_the_failure(
    times: int, record_property: Callable[[str, object], None]
) -> None:
    with hostile_server() as port:
        command = [sys.executable, "-m", "tests.serving.hostile_client", *map(str, (port, times, AT_ONCE))]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True, timeout=120 * times)
    found = json.loads(done.stdout)
    assert len(found["met"]) == times * sum(len(attacks_at(stage)) for stage in STAGES)
    late = [row for row in found["met"] if row[3] > DEADLINE_S + LATE_S]
    assert not late
    unnamed = [
        row for row in found["met"] if row[2] not in (*PolicyError.KINDS, *([None] if row[0] == "close" else []))
    ]
    assert not unnamed
    # A peer whose handshake never ends reaches no stage behind it.
    for stage in ("card", "reset", "act"):
        assert {row[2] for row in found["met"] if row[0] == stage} >= {"died", "garbage", "oversize", "timeout"}
    peak_mb = max(row[4] for row in found["met"])
    assert peak_mb < MEMORY_MB
    record_property("met", len(found["met"]))
    record_property("slowest", max(row[3] for row in found["met"]))
    record_property("peak_mb", peak_mb)


def test_a_flood_of_large_messages_is_not_kept() -> None:
    with hostile_server() as port:
        tracemalloc.start()
        try:
            assert meet(port, "card", "large-message-flood")[2] == "garbage"
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert peak < 8 * MAX_REPLY_BYTES
