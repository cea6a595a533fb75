"""The openpi family against servers written from their descriptions."""

from __future__ import annotations

import contextlib
import hashlib
import re
import tracemalloc
import uuid
from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, strategies
from websockets.sync.server import ServerConnection

from carecontact.audit.raw_log import pose_hand_in_base
from carecontact.errors import ConfigError, ContractError, ObservationError, PolicyError
from carecontact.interface.geometry import quat_from_matrix
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import PANDA
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.dialect_media import cropped, padded, stretched
from carecontact.serving.openpi import cartesian_position, digest, pack, unpack
from carecontact.serving.packing import MAX_REPLY_BYTES
from tests.policies.synthetic import SESSION
from tests.serving.fakes import (
    INSTRUCTION,
    JOINTS,
    OMNI_PATH,
    Fake,
    Omni,
    Openpi,
    OpenpiPositions,
    RoboArena,
    actions,
    joints,
    metadata,
    picture,
    policy_at,
    request,
    seen,
    talk,
    unmark,
)
from tests.serving.test_codec import plain
from tests.serving.test_opening import speaking

ARENA = "roboarena://127.0.0.1:{}"
VELOCITY, POSITION = "openpi://127.0.0.1:{}?profile=pi05-droid", "openpi://127.0.0.1:{}?profile=pi05-droid-jointpos"


def card_at(address: str) -> PolicyCard:
    with policy_at(address) as policy:
        return policy.start()


@pytest.mark.parametrize("steps", [10, 15])
@pytest.mark.parametrize("bare", [False, True])
def test_of_each_chunk_the_horizon_is_executed_index_by_index(steps: int, bare: bool) -> None:
    server = Openpi(steps=steps, bare=bare)
    with server.running() as port:
        replies = talk(VELOCITY.format(port))
    assert [len(reply.actions) for reply in replies] == [8, 8, 8]
    expected = np.concatenate([chunk[:8, :7].astype(np.float64) for chunk in server.answered])
    np.testing.assert_array_equal(joints(replies), expected)
    assert all(action.gripper is None for reply in replies for action in reply.actions)
    assert server.paths == ["/"]


def test_a_horizon_of_the_address_replaces_the_profiles() -> None:
    server = Openpi(steps=15)
    with server.running() as port:
        replies = talk(VELOCITY.format(port) + "&horizon=15", calls=1)
    np.testing.assert_array_equal(joints(replies), server.answered[0][:, :7].astype(np.float64))


def test_a_request_holds_what_droids_client_sends_and_nothing_else() -> None:
    server = Openpi()
    with server.running() as port:
        (reply,) = talk(VELOCITY.format(port), calls=1)
    (heard,) = server.heard
    assert list(heard) == [
        "observation/exterior_image_1_left",
        "observation/wrist_image_left",
        "observation/joint_position",
        "observation/gripper_position",
        "prompt",
    ]
    exterior, wrist = heard["observation/exterior_image_1_left"], heard["observation/wrist_image_left"]
    np.testing.assert_array_equal(exterior, padded(picture(360, 640), (224, 224)), strict=True)
    np.testing.assert_array_equal(wrist, padded(picture(480, 640)[60:420], (224, 224)), strict=True)
    np.testing.assert_array_equal(heard["observation/joint_position"], JOINTS, strict=True)
    np.testing.assert_array_equal(heard["observation/gripper_position"], np.ones(1), strict=True)
    assert heard["prompt"] == INSTRUCTION
    assert reply.sent_sha256 == hashlib.sha256(reply.sent).digest()


def test_the_first_exterior_camera_may_be_number_0() -> None:
    server = Openpi()
    with server.running() as port:
        talk(VELOCITY.format(port) + "&exterior=0", calls=1)
    assert "observation/exterior_image_0_left" in server.heard[0]


@pytest.mark.parametrize(
    ("address", "space", "control", "name"),
    [
        (VELOCITY, "droid_joint_velocity", "droid", "openpi pi05-droid"),
        (POSITION, "joint_position", "droid-sim-evals", "openpi pi05-droid-jointpos"),
    ],
)
def test_the_card_says_all_that_was_chosen(address: str, space: str, control: str, name: str) -> None:
    with Openpi().running() as port:
        card, other = card_at(address.format(port)), card_at(address.format(port) + "&horizon=5")
    assert (card.name, card.action_space, card.control) == (name, space, control)
    assert (card.modalities, card.cameras, card.control_hz) == (("rgb",), ("exterior", "wrist"), 15.0)
    assert card.arguments["horizon"] == "8"
    assert other.arguments == {**card.arguments, "horizon": "5"}


def test_targets_are_passed_on_and_velocities_clipped_to_1() -> None:
    server = OpenpiPositions()
    with server.running() as port:
        replies = talk(POSITION.format(port), calls=2)
    np.testing.assert_array_equal(
        joints(replies), np.concatenate([c[:8, :7].astype(np.float64) for c in server.answered])
    )
    fast = Openpi(fault=lambda reply: {"actions": reply["actions"] * np.array([200.0] * 7 + [1.0])})
    with fast.running() as port:
        replies = talk(VELOCITY.format(port), calls=1)
    expected = np.clip(fast.answered[0][:8, :7].astype(np.float64) * 200, -1, 1)
    np.testing.assert_allclose(joints(replies), expected)
    assert np.abs(joints(replies)).max() == 1.0


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("server_class", [RoboArena, Omni])
def test_roboarena_names_cameras_from_0_or_from_1_and_executes_all(first: int, server_class: type[RoboArena]) -> None:
    server = server_class(steps=5, first=first, external=2)
    with server.running() as port:
        replies = talk(f"roboarena://127.0.0.1:{port}{OMNI_PATH}?exterior={first}")
    np.testing.assert_array_equal(
        joints(replies), np.concatenate([chunk[:, :7].astype(np.float64) for chunk in server.answered])
    )
    assert [message["endpoint"] for message in server.heard] == ["reset", "infer", "infer", "infer", "reset"]
    assert server.paths == [OMNI_PATH]
    request = server.heard[1]
    for name, image in (
        (f"exterior_image_{first}_left", picture(360, 640)),
        (f"exterior_image_{first + 1}_left", picture(482, 640)),
        ("wrist_image_left", picture(480, 640)),
    ):
        np.testing.assert_array_equal(request[f"observation/{name}"], stretched(cropped(image, (16, 9)), (224, 224)))


def test_openpi_without_a_profile_takes_what_the_server_says_of_itself() -> None:
    with RoboArena(space="joint_position", resolution=None, session=False).running() as port:
        card = card_at(f"openpi://127.0.0.1:{port}")
    assert (card.name, card.action_space, card.control) == ("roboarena", "joint_position", "droid")
    assert '"image_resolution": null' in card.arguments["told"]


def test_a_session_id_is_random_and_the_digest_does_not_depend_on_it() -> None:
    server = RoboArena()
    with server.running() as port:
        first, second = (talk(f"roboarena://127.0.0.1:{port}", calls=2) for _ in range(2))
    ids = [message["session_id"] for message in server.heard]
    assert len(ids) == 8
    assert len(set(ids)) == 2
    assert len(set(ids[:4])) == 1, "the same in every message of a trial"
    assert all(uuid.UUID(text).version == 4 for text in ids)
    assert [reply.sent for reply in first] != [reply.sent for reply in second]
    assert [reply.sent_sha256 for reply in first] == [reply.sent_sha256 for reply in second]
    without = {name: value for name, value in unpack(first[0].sent).items() if name != "session_id"}
    assert first[0].sent_sha256 == digest(without)


def test_the_cartesian_position_is_that_of_the_flange() -> None:
    """Against the frames of the shipped arm; the hand sits on the flange, turned by 45 degrees."""
    hand = pose_hand_in_base("panda", JOINTS)
    tcp = hand[:3, 3] + PANDA.tcp_z_m * hand[:3, 2]
    given = cartesian_position(np.array([*tcp, *quat_from_matrix(hand[:3, :3])]))
    np.testing.assert_allclose(given[:3], hand[:3, 3], atol=1e-12)
    # Upstream URDF of the flange: joint 7, then 0.107 m along its axis; z of flange and hand are one.
    cos, sin = np.cos(given[3:]), np.sin(given[3:])
    turn_x = np.array([[1, 0, 0], [0, cos[0], -sin[0]], [0, sin[0], cos[0]]])
    turn_y = np.array([[cos[1], 0, sin[1]], [0, 1, 0], [-sin[1], 0, cos[1]]])
    turn_z = np.array([[cos[2], -sin[2], 0], [sin[2], cos[2], 0], [0, 0, 1]])
    flange = turn_z @ turn_y @ turn_x
    np.testing.assert_allclose(flange[:, 2], hand[:3, 2], atol=1e-9)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(flange[:, 0], hand[:3, :3] @ [half, half, 0], atol=1e-9)


def test_a_key_is_sent_as_a_header_and_shown_nowhere() -> None:
    secret = "sk-very-secret-0123456789"
    server = Openpi(fault=lambda reply: f"Traceback\nValueError: who is {secret}?")
    with server.running() as port, pytest.raises(PolicyError) as caught:
        talk(VELOCITY.format(port), key=secret)
    assert server.headers == [f"Api-Key {secret}"]
    assert secret not in str(caught.value)
    assert "who is ***?" in str(caught.value)


# --- failures ---------------------------------------------------------------------------------------------------------


def replaced(**arrays: object) -> object:
    return lambda reply: {**reply, **arrays}


NAN = np.full((10, 8), np.nan)
ZEROS = np.zeros((10, 8))


@pytest.mark.parametrize(
    ("fault", "kind", "says"),
    [
        (lambda reply: "Traceback (most recent call last):\nValueError: no such key", "exception", "no such key"),
        (lambda reply: {"type": "error", "message": "Internal inference error"}, "exception", "Internal inference"),
        (lambda reply: {"type": "error"}, "exception", "expected its reason as text, got None"),
        (lambda reply: {"action": reply["actions"]}, "garbage", "expected a map with the key actions, got .* action;"),
        (lambda reply: {"actions": NAN}, "action", r"actions\[0\]: expected finite numbers, got nan in column 1"),
        (lambda reply: {"actions": ZEROS[:, :7]}, "action", r"got float64 \(10, 7\): the gripper's column is missing"),
        (lambda reply: {"actions": np.zeros((10, 9))}, "action", r"got float64 \(10, 9\): columns from number 9 on"),
        (lambda reply: {"actions": np.zeros((1, 10, 8))}, "action", r"expected an array of numbers \(steps, 8\)"),
        (lambda reply: {"actions": np.zeros(8)}, "action", r"got float64 \(8,\)"),
        (lambda reply: {"actions": np.zeros((0, 8))}, "action", r"got float64 \(0, 8\)"),
        (lambda reply: {"actions": ZEROS[:5]}, "action", "at least 8 steps, the horizon, got 5; add horizon=5"),
        (lambda reply: {"actions": ZEROS - 1}, "action", r"0 \(open\) to 1 \(closed\) in the last column, got -1"),
        (lambda reply: {"actions": ZEROS + 255}, "action", "another convention, or its columns are in another order"),
        (lambda reply: {"actions": ZEROS > 1}, "action", "expected an array of numbers"),
        (lambda reply: {"actions": [[0.0] * 8]}, "action", r"got list \[\[0.0"),
        (lambda reply: {"actions": "up"}, "action", "got str 'up'"),
        (lambda reply: msgpack.packb({b"actions": 1}), "garbage", "expected text as map keys, got b'actions'"),
        (
            lambda reply: msgpack.packb({"actions": {"__ndarray__": True, "data": b"", "dtype": "<f4", "shape": [0]}}),
            "garbage",
            "got '__ndarray__'; pack with openpi_client.msgpack_numpy",
        ),
        (
            lambda reply: msgpack.packb(
                {"actions": {b"__ndarray__": True, b"data": b"", b"dtype": "|O", b"shape": []}}
            ),
            "garbage",
            "expected an array dtype out of",
        ),
        (lambda reply: b"\xc1", "garbage", "actions message: expected msgpack, got 1 bytes"),
        (lambda reply: bytes(5 << 20), "oversize", "at most 4194304 bytes"),
    ],
)
def test_an_answer_that_cannot_be_executed_is_named(fault: object, kind: str, says: str) -> None:
    with Openpi(fault=fault).running() as port, pytest.raises(PolicyError) as caught:  # pyright: ignore[reportArgumentType]
        talk(VELOCITY.format(port), calls=1)
    assert caught.value.kind == kind
    assert re.search(says, str(caught.value)), str(caught.value)


def test_targets_in_degrees_are_named() -> None:
    with Openpi(fault=lambda reply: {"actions": np.tile([45.0] * 7 + [0.0], (10, 1))}).running() as port:
        with pytest.raises(PolicyError, match=r"expected joint angles in radians, got 45: the server answers in deg"):
            talk(POSITION.format(port), calls=1)


@pytest.mark.parametrize(
    ("metadata", "address", "says"),
    [
        ({}, "openpi://127.0.0.1:{}", r"says nothing of itself.*\?profile=pi05-droid or \?profile=pi05-droid-jointpos"),
        ({"reset_pose": [0]}, "openpi://127.0.0.1:{}", "says only reset_pose of itself"),
        ({}, ARENA, r"expected the field action_space \(.*\), got \[\]; .*is openpi://HOST:PORT\?profile=NAME, one of"),
        ({"action_space": "cartesian_velocity"}, "openpi://127.0.0.1:{}", "got 'cartesian_velocity'; no other one"),
        (
            {"action_space": "joint_position"},
            VELOCITY,
            r"action_space is 'joint_position' in .* metadata and 'joint_velocity' in the profile; the address "
            r"that fits has \?profile=pi05-droid-jointpos or no profile$",
        ),
        ({"action_space": "cartesian_velocity"}, VELOCITY, "in the profile; no profile fits$"),
        ({"needs_stereo_camera": True}, POSITION, "in the profile; no profile fits$"),
        ({"action_space": "joint_velocity"}, "openpi://127.0.0.1:{}?horizon=3", "leave horizon out"),
        (
            {"action_space": "joint_velocity", "needs_stereo_camera": True},
            ARENA,
            "needs_stereo_camera: no camera of this benchmark has two pictures",
        ),
        (
            {"action_space": "joint_velocity", "n_external_cameras": 3},
            ARENA,
            r"expected 0 to 2 \(exterior, bedside\), got 3",
        ),
        ({"action_space": "joint_velocity", "image_resolution": [1 << 20, 9]}, ARENA, "16 to 2048"),
        ({"action_space": "joint_velocity", "needs_session_id": 1}, ARENA, "expected true or false"),
    ],
)
def test_metadata_that_decide_nothing_or_too_much_are_named(metadata: object, address: str, says: str) -> None:
    server = Openpi(metadata=metadata)  # pyright: ignore[reportArgumentType]
    with server.running() as port, pytest.raises(PolicyError, match=says) as caught:
        talk(address.format(port), calls=1)
    assert caught.value.kind == "handshake"
    assert "talk to" not in str(caught.value)


def test_a_camera_named_otherwise_is_the_servers_own_error() -> None:
    with RoboArena(first=0).running() as port, pytest.raises(PolicyError, match="exterior_image_0_left") as caught:
        talk(f"roboarena://127.0.0.1:{port}")
    assert caught.value.kind == "exception"


class Closes(Openpi):
    """After its first chunk."""

    def converse(self, connection: object) -> None:
        connection.send(msgpack.packb({}))  # pyright: ignore[reportAttributeAccessIssue]
        message = msgpack.unpackb(connection.recv(), object_hook=unmark)  # pyright: ignore[reportAttributeAccessIssue]
        connection.send(self.pack({"actions": self.chunk(message)}))  # pyright: ignore[reportAttributeAccessIssue]


class Huge(Fake):
    """Answers with the header of a frame of 1 GB."""

    def converse(self, connection: object) -> None:
        connection.send(msgpack.packb({}))  # pyright: ignore[reportAttributeAccessIssue]
        connection.recv()  # pyright: ignore[reportAttributeAccessIssue]
        connection.socket.sendall(b"\x82\x7f" + (1 << 30).to_bytes(8, "big") + bytes(64))  # pyright: ignore[reportAttributeAccessIssue]
        for _ in connection:  # pyright: ignore[reportGeneralTypeIssues]
            pass


class Pieces(Fake):
    """Answers with an endless message in pieces of 1 MiB."""

    def converse(self, connection: object) -> None:
        connection.send(msgpack.packb({}))  # pyright: ignore[reportAttributeAccessIssue]
        connection.recv()  # pyright: ignore[reportAttributeAccessIssue]
        connection.send(bytes(1 << 20) for _ in range(1000))  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("server", [Huge(), Pieces()], ids=["one frame", "pieces"])
def test_no_more_is_kept_of_a_reply_than_its_bound(server: Fake) -> None:
    tracemalloc.start()
    with server.running() as port, pytest.raises(PolicyError, match="at most 4194304 bytes") as caught:
        talk(VELOCITY.format(port), calls=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert caught.value.kind == "oversize"
    # Both ends and their two pictures live in this process; a thousandth of the reply would be 1 MB.
    assert peak < 8 * MAX_REPLY_BYTES


@pytest.mark.parametrize(
    ("server", "kind", "says"),
    [
        (Closes(), "died", "closed the connection without an answer"),
        (Huge(), "oversize", "at most 4194304 bytes"),
    ],
)
def test_a_lost_connection_is_the_trials_failure_and_never_a_new_one(server: Fake, kind: str, says: str) -> None:
    with server.running() as port, pytest.raises(PolicyError, match=says) as caught:
        talk(VELOCITY.format(port))
    assert caught.value.kind == kind
    assert len(server.paths) == 1


@pytest.mark.parametrize(
    ("status", "says"),
    [
        (401, "HTTP 401; the server wants a key: put it into the variable CARECONTACT_API_KEY"),
        (404, "HTTP 404; the server speaks WebSocket on another path: add it to the address"),
    ],
)
def test_a_refused_handshake_says_what_to_add(status: int, says: str) -> None:
    def refuse(connection: ServerConnection, request: object) -> object:
        return connection.respond(status, "no")

    with speaking(lambda connection: None, process_request=refuse) as port:
        with pytest.raises(PolicyError, match=says) as caught:
            talk(VELOCITY.format(port))
    assert caught.value.kind == "handshake"


def test_a_reset_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for answer, kind, says in (
        ("Traceback (most recent call last):\nKeyError: 'session'", "exception", "KeyError"),
        (msgpack.packb({"type": "error", "message": "busy"}), "exception", "busy"),
        (msgpack.packb([1]), "garbage", "expected a text or a map with status, got list"),
    ):
        monkeypatch.setattr(RoboArena, "confirmed", lambda self, answer=answer: answer)
        with RoboArena().running() as port, pytest.raises(PolicyError, match=says) as caught:
            talk(f"roboarena://127.0.0.1:{port}")
        assert caught.value.kind == kind


def test_an_observation_without_the_picture_is_the_harnesss_mistake() -> None:
    with Openpi().running() as port, policy_at(VELOCITY.format(port)) as policy:
        policy.start()
        policy.reset(INSTRUCTION, SESSION)
        with pytest.raises(ObservationError, match=r"cameras\.wrist\.rgb: expected a picture"):
            policy.act(replace(seen(), cameras={"exterior": seen().cameras["exterior"]}))


# openpi's packing against bytes that its own client made, and against bytes that no client should send.

DATA = Path(__file__).parents[1] / "data" / "openpi"


def test_a_request_has_the_bytes_of_openpis_own_client() -> None:
    assert pack(request()) == (DATA / "request.bin").read_bytes()


@pytest.mark.parametrize("steps", [10, 15])
def test_a_reply_of_openpis_own_packing_is_understood(steps: int) -> None:
    reply = unpack((DATA / f"reply-{steps}.bin").read_bytes())
    assert isinstance(reply, dict)
    assert list(reply) == ["actions", "state", "policy_timing", "server_timing"]
    np.testing.assert_array_equal(reply["actions"], actions(steps), strict=True)
    assert reply["policy_timing"] == {"infer_ms": 41.5}


def test_bare_arrays_and_metadata_are_understood() -> None:
    np.testing.assert_array_equal(unpack((DATA / "bare.bin").read_bytes()), actions(4), strict=True)
    assert unpack((DATA / "metadata.bin").read_bytes()) == {
        "reset_pose": metadata()["reset_pose"],
        "scale": 0.5,
        "flag": True,
    }


def array(**changes: object) -> dict[bytes, object]:
    plain = {b"__ndarray__": True, b"data": bytes(8), b"dtype": "<f4", b"shape": [2]}
    return {**plain, **{name.encode(): value for name, value in changes.items()}}


@pytest.mark.parametrize(
    ("message", "says"),
    [
        ({"a": array(dtype="|O")}, r"message.a: expected an array dtype out of .*got '\|O'"),
        ({"a": array(shape=[3])}, r"expected 12 bytes for an array \[3\] of <f4, got 8 bytes"),
        ({"a": array(data="text")}, "expected 8 bytes .* got str"),
        ({"a": array(more=1)}, "with the keys"),
        ({"a": array(__ndarray__=1)}, "with the keys"),
        ({"a": {b"__npgeneric__": True, b"data": [1], b"dtype": "<f4"}}, "expected a number of one of"),
        ({"a": {b"__npgeneric__": True, b"data": 1, b"dtype": "|O"}}, "expected a number of one of"),
        ({"a": {b"__npgeneric__": True, b"data": 300, b"dtype": "|u1"}}, r"expected a number of \|u1, got 300"),
        ({"a": {b"__npgeneric__": True, b"data": 1}}, "with the keys"),
        ({b"actions": 1}, "expected text as map keys, got b'actions'"),
        ({"__ndarray__": True}, "got '__ndarray__'; pack with openpi_client.msgpack"),
        ({"__npgeneric__": True}, "got '__npgeneric__'; pack with openpi_client.msgpack"),
        ({1: 2}, "expected msgpack, got"),
    ],
)
def test_what_is_not_openpis_is_refused(message: object, says: str) -> None:
    """The bounds of both packings are one code, which test_codec.py tests."""
    with pytest.raises(ContractError, match=says):
        unpack(msgpack.packb(message))


@given(plain)
def test_what_is_packed_comes_back(value: object) -> None:
    assert pack(unpack(pack(value))) == pack(value)


@given(strategies.binary(max_size=200))
def test_any_bytes_are_understood_or_refused_with_a_reason(data: bytes) -> None:
    with contextlib.suppress(ContractError):
        unpack(data)


@pytest.mark.parametrize(
    ("address", "says"),
    [
        (
            "openpi://gpu:8000?profile=pi05-droit",
            r"no profile named 'pi05-droit' \(did you mean 'pi05-droid'\?\); valid: pi05-droid, pi05-droid-jointpos",
        ),
        ("vla-eval://gpu:8000?space=joint", r"no action space 'joint' in this dialect.*valid: droid_joint_vel"),
    ],
)
def test_an_unknown_name_is_refused_before_anything_is_connected(address: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        PolicySetup.of(address)
    assert address in str(caught.value)


def test_known_names_pass() -> None:
    for address in ("openpi://gpu:8000?profile=pi05-droid", "vla-eval://gpu:8000?space=joint_position"):
        assert PolicySetup.of(address).ref.text == address
