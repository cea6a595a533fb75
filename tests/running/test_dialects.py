"""A trial with a server of every dialect: what is executed is what the server sent, index by index."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import pytest

from carecontact.episode.perception import Peak
from carecontact.episode.randomization import World
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.running.trial import run_trial
from tests.serving.fakes import OMNI_PATH, Fake, Omni, Openpi, OpenpiPositions, RoboArena, VlaEval

SECONDS = 1.2
"""18 actions at 15 Hz: three chunks of eight, or of seven, the last one cut by the time. Slow tests run all of T1."""
Run = Callable[[Fake, str], Recording]


@pytest.fixture(scope="module", params=[SECONDS, pytest.param(30.0, marks=pytest.mark.slow)])
def run(request: pytest.FixtureRequest, again: Callable[..., World]) -> Run:
    """``run(server, address)``: a trial of T1; the address has {} for the port."""
    protocol = overridden(load_protocol("bathing-v3"), {"phases.time_limit_s": request.param})

    def run_one(server: Fake, address: str) -> Recording:
        with server.running() as port, pytest.MonkeyPatch.context() as patch:
            # The report's two pictures are not what is tested here.
            patch.setattr(Peak, "pictures", lambda self, renderer, region: {})
            spec = TrialSpec(protocol=protocol, task_id="T1", seed=0, policy=address.format(port))
            return run_trial(spec, prepare=again)

    return run_one


@dataclass(frozen=True)
class Case:
    make: Callable[[], Fake]
    address: str
    executed: int | None
    """Of a chunk; None: all."""
    space: str = "droid_joint_velocity"
    control: str = "droid"


CASES = {
    "openpi, 10 steps": Case(Openpi, "openpi://127.0.0.1:{}?profile=pi05-droid", 8),
    "openpi, 15 steps, bare": Case(lambda: Openpi(steps=15, bare=True), "openpi://127.0.0.1:{}?profile=pi05-droid", 8),
    "openpi, targets": Case(
        OpenpiPositions, "openpi://127.0.0.1:{}?profile=pi05-droid-jointpos", 8, "joint_position", "droid-sim-evals"
    ),
    "RoboArena from 0": Case(lambda: RoboArena(first=0, steps=7), "roboarena://127.0.0.1:{}?exterior=0", None),
    "RoboArena from 1, two cameras": Case(lambda: RoboArena(external=2, steps=7), "openpi://127.0.0.1:{}", None),
    "vllm-omni": Case(lambda: Omni(steps=7), "roboarena://127.0.0.1:{}" + OMNI_PATH, None),
    "vla-eval": Case(VlaEval, "vla-eval://127.0.0.1:{}", None, "joint_position"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_executed_is_what_the_server_sent(run: Run, name: str) -> None:
    case = CASES[name]
    server = case.make()
    recording = run(server, case.address)
    assert recording.header.ended == "time_limit", recording.header.failure
    card = recording.header.card
    assert card is not None
    assert (card["action_space"], card["control"]) == (case.space, case.control)
    assert recording.header.control == case.control
    sent = np.concatenate([chunk[: case.executed, :7].astype(np.float64) for chunk in server.answered])
    executed = recording["actions/joint"]
    count = round(15 * recording.header.spec.protocol.phases.time_limit_s)
    np.testing.assert_array_equal(executed, sent[:count], strict=True)
    assert len(recording["policy/observation_time_s"]) == len(server.answered)


def test_equal_trials_have_equal_recordings_although_the_session_id_differs(run: Run) -> None:
    servers = [RoboArena(steps=7), RoboArena(steps=7)]
    one, other = (run(server, "roboarena://127.0.0.1:{}") for server in servers)
    assert servers[0].heard[0]["session_id"] != servers[1].heard[0]["session_id"]
    name = "policy/observation_sha256"
    assert len(one[name]) >= 3
    np.testing.assert_array_equal(one[name], other[name])


def _object_array(reply: object) -> bytes:
    marks = {b"__ndarray__": True, b"data": b"", b"dtype": "|O", b"shape": []}
    return msgpack.packb({"actions": marks})


FAULTS: dict[str, tuple[Callable[[Any], object], str, str]] = {
    "NaN": (lambda reply: {"actions": reply["actions"] * np.nan}, "action", "expected finite numbers"),
    "wrong shape": (lambda reply: {"actions": reply["actions"][:, :7]}, "action", "gripper's column is missing"),
    "text": (lambda reply: "Traceback (most recent call last):\nValueError: no such key", "exception", "no such key"),
    "error map": (lambda reply: {"type": "error", "message": "CUDA out of memory"}, "exception", "CUDA out of memory"),
    "object dtype": (_object_array, "garbage", "expected an array dtype out of"),
    "keys of bytes": (lambda reply: msgpack.packb({b"actions": 1}), "garbage", "expected text as map keys"),
    "too large": (lambda reply: bytes(5 << 20), "oversize", "at most 4194304 bytes"),
}
"""What a server answers the second time -> kind of the failure, and what it says."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_second_chunk_is_the_trials_process_failure(run: Run, name: str) -> None:
    fault, kind, says = FAULTS[name]
    chunks = iter([lambda reply: reply, fault])
    recording = run(Openpi(fault=lambda reply: next(chunks)(reply)), "openpi://127.0.0.1:{}?profile=pi05-droid")
    assert recording.header.ended == "process_failure"
    assert recording.header.failure is not None
    assert recording.header.failure.kind == kind
    assert says in recording.header.failure.message
    assert len(recording["actions/joint"]) == 8
