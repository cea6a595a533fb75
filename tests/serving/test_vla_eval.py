"""vla-eval's protocol 1 against a server written from its description."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import msgpack
import numpy as np
import pytest

from carecontact.cli import main
from carecontact.errors import PolicyError
from tests.policies.synthetic import SESSION
from tests.serving.fakes import INSTRUCTION, JOINTS, VlaEval, joints, picture, policy_at, seen, talk

ADDRESS = "vla-eval://127.0.0.1:{}"
EITHER = r"\?space=joint_position or \?space=droid_joint_velocity"
RAW = {"actions": {"name": "raw", "dims": 0, "format": "raw"}}
BOTH = {"send_wrist_image": True, "send_state": True}


def spec(**parts: object) -> dict[str, object]:
    return {"observation_params": BOTH, "action_spec": parts}


def test_one_action_is_executed_for_each_observation() -> None:
    server = VlaEval()
    with server.running() as port:
        replies = talk(ADDRESS.format(port), calls=4)
    assert [len(reply.actions) for reply in replies] == [1] * 4
    np.testing.assert_array_equal(joints(replies), np.concatenate(server.answered)[:, :7].astype(np.float64))
    assert all(reply.sent_sha256 == hashlib.sha256(reply.sent).digest() for reply in replies)


def test_of_the_episode_a_server_learns_the_instruction_and_nothing_else() -> None:
    server = VlaEval()
    with server.running() as port:
        talk(ADDRESS.format(port), calls=1)
    envelopes = [(message["type"], message["seq"], message["timestamp"]) for message in server.heard]
    assert envelopes == [("hello", 1, 0.0), ("episode_start", 2, 0.0), ("observation", 3, 0.0), ("episode_end", 4, 0.0)]
    hello, start, observation, end = (message["payload"] for message in server.heard)
    assert hello == {"harness_version": "carecontact", "protocol_version": 1}
    assert start == {"task": {"name": INSTRUCTION}}
    assert end == {}
    assert list(observation) == ["images", "task_description", "states"]
    assert observation["task_description"] == INSTRUCTION
    np.testing.assert_array_equal(observation["states"], [*JOINTS, 1.0], strict=True)
    assert list(observation["images"]) == ["exo_camera_1", "wrist_camera"]
    np.testing.assert_array_equal(observation["images"]["exo_camera_1"], picture(360, 640), strict=True)
    np.testing.assert_array_equal(observation["images"]["wrist_camera"], picture(480, 640)[60:420], strict=True)


def test_what_the_server_does_not_ask_for_is_neither_rendered_nor_sent() -> None:
    server = VlaEval(payload={"action_spec": RAW})
    with server.running() as port, policy_at(ADDRESS.format(port) + "?space=joint_position") as policy:
        card = policy.start()
    assert card.cameras == ("exterior",)
    assert card.arguments["state"] == "no"


@pytest.mark.parametrize(
    ("payload", "query", "space"),
    [
        (spec(joints={"dims": 7, "format": "joint_pos_abs"}), "", "joint_position"),
        (spec(joints={"dims": 7, "format": "joint_positions"}, gripper={"dims": 1}), "", "joint_position"),
        (spec(**RAW), "?space=droid_joint_velocity", "droid_joint_velocity"),
        (spec(action={"dims": 8, "format": "raw"}), "?space=joint_position", "joint_position"),
        ({"observation_params": BOTH}, "?space=joint_position", "joint_position"),
        (spec(joints={"dims": 7, "format": "joint_positions"}), "?space=joint_position", "joint_position"),
        (
            spec(joints={"dims": 7, "format": "joint_velocity"}),
            "?space=droid_joint_velocity",
            "droid_joint_velocity",
        ),
    ],
)
def test_the_space_comes_from_a_known_spec_or_from_the_address(
    payload: dict[str, object], query: str, space: str
) -> None:
    with VlaEval(payload=payload).running() as port, policy_at(ADDRESS.format(port) + query) as policy:
        card = policy.start()
    assert (card.name, card.action_space, card.control) == ("vla-eval", space, "droid")
    assert card.arguments == {"dialect": "vla-eval", "space": space, "state": "yes"}


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        ({}, f"the server does not say what its actions mean; name the space in the address: {EITHER}$"),
        (spec(**RAW), rf"its actions are actions \(0 of 'raw'\); name the space in the address: {EITHER}$"),
        (
            spec(joints={"dims": 7, "format": "joint_velocity"}),
            r"joints \(7 of 'joint_velocity'\); if it fits, name the space in the address: "
            r"\?space=droid_joint_velocity$",
        ),
        ({"action_spec": [1]}, r"action_spec: expected a map, got \[1\]"),
        ({"observation_params": {"send_video_history": True}}, "the server asks for send_video_history"),
        ({"observation_params": [1]}, "observation_params: expected a map"),
        ({"protocol_version": 2}, "expected protocol_version 1, got 2"),
    ],
)
def test_a_server_with_unknown_actions_is_refused(payload: dict[str, object], says: str) -> None:
    with VlaEval(payload=payload).running() as port, pytest.raises(PolicyError, match=says) as caught:
        talk(ADDRESS.format(port))
    assert caught.value.kind == "handshake"


DELTAS = {
    "position": {"dims": 3, "format": "delta_xyz"},
    "rotation": {"dims": 3, "format": "axis_angle"},
    "gripper": {"dims": 1, "format": "binary_close_positive"},
}


@pytest.mark.parametrize("parts", [DELTAS, {"gripper": DELTAS["gripper"]}, {"position": DELTAS["position"]}])
def test_differences_of_the_pose_need_a_profile(parts: dict[str, object]) -> None:
    says = r"differences of the tool's pose, .*: \?profile=libero or \?profile=bridge"
    with VlaEval(payload=spec(**parts)).running() as port, pytest.raises(PolicyError, match=says):
        talk(ADDRESS.format(port))


@pytest.mark.parametrize("query", ["", "?space=joint_position", "?space=droid_joint_velocity"])
@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({"position": {"dims": 3, "format": "absolute_xyz"}}, r"position \(3 of 'absolute_xyz'\)"),
        ({"joints": {"dims": 7, "format": "joint_delta_pos"}}, r"joints \(7 of 'joint_delta_pos'\)"),
        ({"joints": {"dims": 14, "format": "joint_positions"}}, r"joints \(14 of 'joint_positions'\)"),
        ({"joints": {"dims": np.arange(2), "format": np.arange(2)}}, r"joints \("),
        ({"actions": {"dims": 14, "format": "raw"}}, r"actions \(14 of 'raw'\)"),
        ({"joints": {"dims": 7, "format": "joint_positions"}, "base_motion": {"dims": 4, "format": "raw"}}, "base_m"),
        ({"joints": 7}, "'joints'"),
    ],
)
def test_actions_that_no_space_executes_are_refused_and_no_address_helps(
    parts: dict[str, object], named: str, query: str
) -> None:
    says = f"the server says that its actions are .*{named}.*, which no action space here executes; expected joints"
    with (
        VlaEval(payload=spec(**parts)).running() as port,
        pytest.raises(PolicyError, match=says) as caught,
        policy_at(ADDRESS.format(port) + query) as policy,
    ):
        policy.start()
    assert caught.value.kind == "handshake"
    assert "space=" not in str(caught.value).partition("failed at start")[2]


@pytest.mark.parametrize(
    ("form", "named", "remedy"),
    [
        ("joint_positions", "droid_joint_velocity", "leave space out"),
        ("joint_velocity", "joint_position", r"\?space=droid_joint_velocity would fit"),
    ],
)
@pytest.mark.parametrize("command", ["check", "run"])
def test_an_address_that_contradicts_the_server_is_an_error_before_the_first_trial(
    form: str,
    named: str,
    remedy: str,
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    server = VlaEval(payload=spec(joints={"dims": 7, "format": form}, gripper={"dims": 1, "format": "continuous_01"}))
    with server.running() as port:
        address = ADDRESS.format(port) + f"?space={named}"
        if command == "check":
            assert main(["check", address]) == 1
        else:
            assert main(["run", "--policy", address, "--out", "r", "--tasks", "T1", "--seeds", "0"]) == 2
    shown = capsys.readouterr()
    says = rf"joints \(7 of '{form}'\), but the address says \?space={named}; {remedy}"
    assert re.search(says, " ".join((shown.out + shown.err).split()))
    assert {message["type"] for message in server.heard} == {"hello"}
    assert not list(tmp_path.glob("r/*.h5"))


def envelope(**changes: object) -> bytes:
    return msgpack.packb({"type": "action", "payload": {}, "seq": 3, "timestamp": 0.0, **changes})


@pytest.mark.parametrize(
    ("fault", "kind", "says"),
    [
        (lambda answer: {"error": "observation_failed: KeyError: 'states'"}, "exception", "KeyError: 'states'"),
        (lambda answer: {"error": None}, "exception", "an error .*None"),
        (lambda answer: {}, "action", r"actions: expected an array, got NoneType in the keys \[\]"),
        (lambda answer: {"actions": np.zeros((5, 8))}, "action", "one action for each observation, got 5; set chunk"),
        (lambda answer: {"actions": np.full(8, np.nan)}, "action", r"actions\[0\]: expected finite numbers"),
        (lambda answer: {"actions": np.zeros(14)}, "action", r"got float64 \(1, 14\): columns from number 9 on"),
        (lambda answer: {"actions": np.zeros(6)}, "action", r"got float64 \(1, 6\)"),
        (lambda answer: {"actions": np.full(7, 90.0)}, "action", "expected joint angles in radians, got 90"),
        (lambda answer: "text", "garbage", "expected a binary message, got text 'text'"),
        (lambda answer: b"\xc1", "garbage", "action message: expected msgpack"),
        (lambda answer: envelope(more=1), "garbage", "expected a map with the keys type, payload, seq, timestamp"),
        (lambda answer: envelope(type="hello"), "garbage", "expected 'action' as the answer to message 3, got 'hello'"),
        (lambda answer: envelope(seq=2), "garbage", "as the answer to message 3, got 'action' to message 2"),
        (
            lambda answer: envelope(payload={"__ndarray__": True, "data": b"", "dtype": "|O", "shape": [0]}),
            "garbage",
            "expected an array dtype",
        ),
        (lambda answer: msgpack.packb({b"type": "action"}), "garbage", "expected text as map keys"),
        (lambda answer: bytes(5 << 20), "oversize", "at most 4194304 bytes"),
    ],
)
def test_an_answer_that_cannot_be_executed_is_named(fault: object, kind: str, says: str) -> None:
    server = VlaEval(fault=fault)  # pyright: ignore[reportArgumentType]
    with server.running() as port, pytest.raises(PolicyError, match=says) as caught:
        talk(ADDRESS.format(port), calls=1)
    assert caught.value.kind == kind


def test_a_gripper_of_another_convention_passes_since_the_hand_is_closed() -> None:
    server = VlaEval(fault=lambda answer: {"actions": np.array([*answer["actions"][:7], 255.0])})
    with server.running() as port:
        replies = talk(ADDRESS.format(port), calls=2)
    assert len(joints(replies)) == 2


class Late(VlaEval):
    """Refuses the start of an episode, as the original does: with an error that nothing asked for."""

    def converse(self, connection: object) -> None:
        hello = msgpack.unpackb(connection.recv())  # pyright: ignore[reportAttributeAccessIssue]
        self.tell(connection, "hello", {"protocol_version": 1, **self.payload}, hello["seq"])  # pyright: ignore[reportArgumentType]
        start = msgpack.unpackb(connection.recv())  # pyright: ignore[reportAttributeAccessIssue]
        self.tell(connection, "error", {"error": "episode_start_failed: no weights"}, start["seq"])  # pyright: ignore[reportArgumentType]
        for _ in connection:  # pyright: ignore[reportGeneralTypeIssues]
            pass


def test_a_start_that_the_server_refuses_is_reported_with_its_reason() -> None:
    with Late().running() as port, policy_at(ADDRESS.format(port)) as policy:
        policy.start()
        policy.reset(INSTRUCTION, SESSION)
        with pytest.raises(PolicyError, match="episode_start_failed: no weights") as caught:
            policy.act(seen())
    assert caught.value.kind == "exception"
