from __future__ import annotations

import dataclasses
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from carecontact.errors import ActionError, ContractError, ObservationError, PolicyError
from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.action_spaces import check_action
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Compliance
from carecontact.serving import codec
from carecontact.serving.packing import DTYPES, MAX_ITEMS, MAX_REPLY_BYTES, MAX_VALUES, pack, unpack
from tests.policies.synthetic import BOUNDS, SESSION, synthetic_observation, synthetic_view

number = st.floats(allow_nan=False, width=64)
actions = st.builds(
    Action,
    pose_tcp_in_base=st.none() | hnp.arrays(np.float64, 7, elements=st.floats(-10, 10)),
    stiffness=st.none() | st.tuples(number, number) | st.tuples(*[number] * 6),
    damping_ratio=st.none() | number,
    wrench_in_tcp=st.none() | hnp.arrays(np.float64, 6, elements=st.floats(-10, 10)),
    delta=st.none() | hnp.arrays(np.float64, 6, elements=st.floats(-10, 10)),
    joint=st.none() | hnp.arrays(np.float64, 7, elements=st.floats(-10, 10)),
    gripper=st.none() | number,
    done=st.booleans(),
)


def _assert_same(a: object, b: object) -> None:
    if dataclasses.is_dataclass(a):
        assert type(a) is type(b)
        for field in dataclasses.fields(a):
            _assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            _assert_same(a[key], b[key])
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    else:
        assert a == b
        assert type(a) is type(b)


@given(st.lists(actions, min_size=1, max_size=4))
@settings(max_examples=100, deadline=None)
def test_actions_round_trip(chunk: list[Action]) -> None:
    back = codec.decode_actions(unpack(pack(codec.encode_actions(chunk))))
    for a, b in zip(chunk, back, strict=True):
        _assert_same(a, b)


@given(
    st.integers(1, 5),
    st.integers(1, 5),
    st.integers(0, 4),
    st.sets(st.sampled_from(["rgb", "depth", "points", "point_colors", "masks", "landmarks", "landmarks_in_base"])),
    st.sets(st.sampled_from(["overhead", "bedside", "exterior", "wrist"])),
)
@settings(max_examples=60, deadline=None)
def test_observation_round_trip(height: int, width: int, points: int, absent: set[str], cameras: set[str]) -> None:
    view = synthetic_view(height=height, width=width, points=points)
    view = dataclasses.replace(view, **dict.fromkeys(absent))
    observation = synthetic_observation(cameras=dict.fromkeys(cameras, view), sim_time_s=1.25)
    data = pack({"observation": codec.encode_observation(observation)})
    _assert_same(observation, codec.decode_observation(unpack(data)["observation"]))


def test_bytes_do_not_depend_on_the_order_of_cameras() -> None:
    view = synthetic_view()
    one = synthetic_observation(cameras={"overhead": view, "wrist": view})
    other = synthetic_observation(cameras={"wrist": view, "overhead": view})
    assert pack(codec.encode_observation(one)) == pack(codec.encode_observation(other))


def test_the_tool_s_velocity_is_in_a_message_only_where_it_was_requested() -> None:
    still = synthetic_observation(cameras={})
    assert "velocity_tcp_in_base" not in codec.encode_observation(still), "the bytes without it stay"
    moving = dataclasses.replace(still, velocity_tcp_in_base=np.arange(6.0))
    _assert_same(moving, codec.decode_observation(unpack(pack(codec.encode_observation(moving)))))
    with pytest.raises(ObservationError, match=r"velocity_tcp_in_base: expected float64 \(6\) with .*, got .* \(7,\)"):
        codec.encode_observation(dataclasses.replace(still, velocity_tcp_in_base=np.zeros(7)))


def test_session_and_card_round_trip() -> None:
    masses = {"effective_mass_kg": 10.0, "effective_inertia_kgm2": 0.2}
    compliant = dataclasses.replace(
        SESSION, compliance=Compliance(stiffness=(400.0, 20.0), damping_ratio=1.0, **masses)
    )
    erring = dataclasses.replace(SESSION, force_bias_n=1.0, joint_friction_nm=(0.1,) * 7)
    for session in (SESSION, compliant, erring):
        assert codec.decode_session(unpack(pack(codec.encode_session(session)))) == session
    assert codec.encode_session(erring).keys() - codec.encode_session(SESSION) == {"force_bias_n", "joint_friction_nm"}
    card = PolicyCard(name="n", modalities=("rgb", "depth"), cameras=("wrist",), control_hz=15, language_backend="x")
    assert codec.decode_card(unpack(pack(codec.encode_card(card)))) == card
    assert codec.decode_card({"name": "short"}) == PolicyCard(name="short")
    later = {"arguments", "environment", "tool_velocity"}
    assert not later & set(codec.encode_card(card)), "the bytes of a card without them stay"
    deltas = dataclasses.replace(card, action_space="cartesian_delta", delta="bridge")
    assert codec.decode_card(unpack(pack(codec.encode_card(deltas)))) == deltas
    given = dataclasses.replace(card, arguments={"steps": "3"}, environment=("TOKEN",), tool_velocity=True)
    assert codec.decode_card(unpack(pack(codec.encode_card(given)))) == given


def _planted(place: str, key: str) -> dict[str, object]:
    plain = codec.encode_observation(synthetic_observation(cameras={"overhead": synthetic_view()}))
    target: object = plain
    for part in filter(None, place.split(".")):
        target = target[part]
    target[key] = np.zeros(3)
    return plain


@pytest.mark.parametrize(
    ("place", "key", "says"),
    [
        ("", "contact_force", "unknown key contact_force; valid: instruction"),
        ("cameras.overhead", "body_pose", "unknown key body_pose"),
        ("cameras.overhead.masks", "right_forearm", "no mask 'right_forearm'; valid: human"),
        ("cameras", "shell", "no camera 'shell'; valid: overhead"),
    ],
)
def test_a_privileged_key_is_an_error(place: str, key: str, says: str) -> None:
    with pytest.raises(ObservationError, match=says):
        codec.decode_observation(_planted(place, key))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"joint_velocity": np.zeros(8)}, r"joint_velocity: expected float64 \(joints\) with .*, got float64 \(8,\)"),
        ({"joint_velocity": np.zeros(7, np.float32)}, "got float32"),
        ({"joint_position": [0.0] * 7}, "got list"),
        ({"instruction": 3}, "expected text, got int 3"),
        ({"sim_time_s": "now"}, "expected a number, got str 'now'"),
        ({"cameras": {"ceiling": synthetic_view()}}, "no camera 'ceiling'"),
    ],
)
def test_a_field_that_does_not_fit_is_not_sent(changes: dict[str, object], says: str) -> None:
    with pytest.raises(ObservationError, match=says):
        codec.encode_observation(dataclasses.replace(synthetic_observation(), **changes))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"depth": np.zeros((5, 8), np.float32)}, r"depth: expected float32 \(H, W\) with {'H': 6, 'W': 8}"),
        ({"masks": {"human": np.zeros((6, 7), bool)}}, r"masks.human: expected bool \(H, W\)"),
        ({"point_colors": np.zeros((4, 3), np.uint8)}, r"point_colors: expected uint8 \(N, 3\)"),
        ({"rgb": np.zeros((6, 8, 4), np.uint8)}, "rgb"),
        ({"landmarks": np.zeros((17, 3), np.float32)}, r"landmarks: expected float32 \(33, 3\)"),
        ({"intrinsics": None}, "intrinsics: expected float64"),
    ],
)
def test_modalities_of_one_camera_agree(changes: dict[str, object], says: str) -> None:
    view = dataclasses.replace(synthetic_view(), **changes)
    with pytest.raises(ObservationError, match=says):
        codec.encode_observation(synthetic_observation(cameras={"overhead": view}))


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (None, "expected an Action or a list of Actions, got NoneType"),
        ({"pose": 1}, r"got dict {'pose': 1}; return Action\(pose_tcp_in_base=\[x, y, .* in place of the dict$"),
        ([{"pose": 1}], r"; return \[Action\(pose_tcp_in_base=.*, \.\.\.\] in place of the dicts$"),
        ([0.4, 0, 0.4, 0, 1, 0, 0], r"; return Action\(pose_tcp_in_base=.* in place of bare numbers$"),
        (np.zeros(7), r"got an array float64 \(7,\); return Action\(pose_tcp_in_base=.* in place of bare numbers$"),
        ([0.4, 0, 0.4, 0, 1, 0], "; six numbers look like x y z and roll pitch yaw: .* w x y z; return Action"),
        (
            np.zeros((3, 8)),
            "; eight numbers look like seven joints and a gripper: give the last one as gripper; return ",
        ),
        ([[0.4] * 7] * 3, r"; return \[Action\(pose_tcp_in_base=row\) for row in rows\], or with joint"),
        (np.zeros((3, 6)), r"; six numbers look .*; return \[Action\(pose_tcp_in_base=row\) for row in rows\]"),
        ([], "expected 1 to 2000 actions, got 0"),
        ([Action()] * (MAX_CHUNK + 1), "got 2001"),
        ([Action(), 3], r"act\[1\]: expected an Action, got int 3"),
        (Action(pose_tcp_in_base=[[0, 1], [2]]), "pose_tcp_in_base: expected a list or array of 7 numbers"),
        (Action(pose_tcp_in_base=np.zeros(7, bool)), "got an array bool"),
        (Action(pose_tcp_in_base="up"), "expected a list or array of 7 numbers"),
        (Action(stiffness=400.0), "stiffness: expected"),
        (Action(stiffness=(400.0, "soft")), r"stiffness\[1\]: expected a number"),
        (Action(stiffness=(True, 1.0)), r"stiffness\[0\]: expected a number"),
        (Action(gripper="open"), "gripper: expected a number"),
        (Action(stiffness=(1.0, 2.0, 3.0)), "six numbers or None, got list"),
        (Action(damping_ratio="soft"), "damping_ratio: expected a number"),
        (Action(joint="up"), "joint: expected a list or array of numbers, one for each joint"),
        (Action(wrench_in_tcp=np.zeros(6, bool)), "wrench_in_tcp: expected a list or array of 6 numbers"),
        (Action(delta=np.zeros(6, bool)), "delta: expected a list or array of 6 numbers"),
        (Action(done=1), "done: expected True or False, got int 1"),
    ],
)
def test_a_wrong_answer_is_named(answer: object, says: str) -> None:
    with pytest.raises(ActionError, match=says):
        codec.encode_actions(answer)


def test_a_pose_may_be_a_plain_list_of_numbers() -> None:
    (action,) = codec.decode_actions([{"pose_tcp_in_base": [0.4, 0, 0.4, 0, 1, 0, 0]}])
    np.testing.assert_array_equal(action.pose_tcp_in_base, [0.4, 0, 0.4, 0, 1, 0, 0])
    for wrong in ([0.4, None], ["a"], [True] * 7, "up", {}):
        with pytest.raises(ActionError, match=r"actions\[0\].pose_tcp_in_base: expected a list or array of 7"):
            codec.decode_actions([{"pose_tcp_in_base": wrong}])


@pytest.mark.parametrize(
    ("plain", "says"),
    [
        (
            [0.4, 0, 0.4, 0, 1, 0, 0],
            r"^actions: expected a list of maps, got list .*; send a map for each action, as in \[",
        ),
        ([[0.4] * 7] * 3, "; send a map for each action, as in "),
        (np.zeros((3, 6)), "; six numbers look like x y z and roll pitch yaw: .*; send a map for each action, as in "),
        ({"pose_tcp_in_base": [0.4] * 7}, r'; put each action into a list, as in \[{"pose_tcp_in_base": \[x'),
        (
            [{"pose_tcp_in_base": [[0.4] * 7] * 3}],
            r"actions\[0\]\.pose_tcp.*; these look like 3 poses: send a list",
        ),
        (
            [{"pose": [0.4] * 7}],
            r"^actions\[0\]: unknown key pose \(did you mean 'pose_tcp_in_base'\?\); valid: pose_t",
        ),
        ([{"Gripper": 1, "zzz": 2}], r"unknown key Gripper \(did you mean 'gripper'\?\), zzz; valid: .*, done$"),
        ([{f"key{i:02}": i for i in range(99)}], "unknown key key00, key01, key02, key03; valid: "),
    ],
)
def test_a_wrong_answer_on_the_wire_is_named_with_what_to_send(plain: object, says: str) -> None:
    with pytest.raises(ActionError, match=says):
        codec.decode_actions(plain)


@pytest.mark.parametrize(
    ("card", "says"),
    [
        ({"name": "x", "control_hz": 5}, r"; write card = PolicyCard\(name='x', control_hz=5\) in place of the dict$"),
        (None, r"; a policy shows a PolicyCard as its attribute 'card', for example card = PolicyCard\(name="),
    ],
)
def test_a_hint_shows_how_to_make_a_card(card: object, says: str) -> None:
    with pytest.raises(PolicyError, match=says):
        codec.encode_card(card)


class Inconvertible:
    def __array__(self) -> None:
        raise RuntimeError("on another device")


def test_an_answer_that_numpy_cannot_take_is_named_too() -> None:
    with pytest.raises(ActionError, match="expected an Action or a list of Actions, got Inconvertible"):
        codec.encode_actions(Inconvertible())


@pytest.mark.parametrize(
    ("card", "says"),
    [
        (None, "expected a PolicyCard, got NoneType"),
        ({"name": "n", "seed": 3}, "unknown key seed"),
        ({"name": "n", "camera": ["wrist"]}, r"^card: unknown key camera \(did you mean 'cameras'\?\); valid: name, "),
        ({"name": "n", "hz": 5}, r"unknown key hz; valid: name, .* camera_hz, control_hz"),
        ({"name": "n", "fps": 5}, r"unknown key fps; valid: name, .* control_hz"),
        ({}, "expected the key name"),
        ({"name": "n", "cameras": ["ceiling"]}, "out of overhead, .* got 'ceiling'"),
        ({"name": "n", "cameras": "overhead"}, "a list of names"),
        ({"name": "n", "control_hz": "fast"}, "a number from 1 to 50"),
        ({"name": "n", "control_hz": float("nan")}, "1 to 50"),
        ({"name": 1}, "expected text"),
        ({"name": "n", "control": 1}, "card.control: expected text"),
        ({"name": "n", "control": "mine"}, "control: expected one of cartesian-impedance"),
        ({"name": "n", "arguments": [1]}, "PolicyCard.arguments: expected at most 64 names with printable texts"),
        (
            {"name": "n", "camera_hz": 5},
            r"camera_hz: expected a mapping from cameras of the card \(overhead\)",
        ),
        ({"name": "n", "camera_hz": {"wrist": 5}}, r"rates from 0 to 50 \[Hz\], got {'wrist': 5}"),
        ({"name": "n", "arguments": {"a": 1}}, "PolicyCard.arguments: expected at most 64 names with printable texts"),
        ({"name": "n", "arguments": {"a b": "1"}}, "arguments: expected at most 64 names"),
        ({"name": "n", "environment": "TOKEN"}, "card.environment: expected a list of names"),
        ({"name": "n", "tool_velocity": 1}, "PolicyCard.tool_velocity: expected True or False, got 1"),
    ],
)
def test_a_wrong_card_is_a_handshake_failure(card: object, says: str) -> None:
    with pytest.raises(PolicyError, match=says) as caught:
        codec.encode_card(card) if card is None else codec.decode_card(card)
    assert caught.value.kind == "handshake"


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"seed": 3}, "unknown key seed"),
        ({"camera_sizes_px": {"wrist": [4.5, 3]}}, "camera_sizes_px.wrist: expected whole pixels"),
        ({"camera_sizes_px": {"wrist": [4, 3.5]}}, "camera_sizes_px.wrist: expected whole pixels"),
        ({"compliance": {"stiffness": [400.0]}}, "session.compliance: expected the key"),
    ],
)
def test_a_wrong_session_is_refused(changed: dict[str, object], says: str) -> None:
    with pytest.raises(ContractError, match=says):
        codec.decode_session(codec.encode_session(SESSION) | changed)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_poses_travel_and_are_refused_by_the_contract(bad: float) -> None:
    pose = np.array([0.4, 0.0, bad, 0.0, 1.0, 0.0, 0.0])
    (action,) = codec.decode_actions(unpack(pack(codec.encode_actions(Action(pose_tcp_in_base=pose)))))
    with pytest.raises(ActionError, match="finite"):
        check_action(action, BOUNDS)


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=8)
    | st.sampled_from(DTYPES).flatmap(
        lambda d: hnp.arrays(np.dtype(d), hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3))
    ),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(_same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(_same, a, b))
    return type(a) is type(b) and a == b


@given(plain)
@settings(max_examples=80, deadline=None)
def test_what_is_packed_is_unpacked(value: object) -> None:
    assert _same(value, unpack(pack(value)))


def test_nan_payloads_and_byte_order_survive() -> None:
    odd = np.array([0x7FC00001, 0xFFC12345], "<u4").view("<f4")
    assert unpack(pack(odd)).tobytes() == odd.tobytes()
    big = unpack(pack(np.array([1.5, -2.0], ">f8")))
    assert big.dtype == np.dtype("<f8")
    assert big.tolist() == [1.5, -2.0]


def test_strided_input_arrives_in_c_order_and_writable() -> None:
    out = unpack(pack(np.arange(6).reshape(2, 3).T[::-1]))
    assert out.tolist() == [[2, 5], [1, 4], [0, 3]]
    out[0, 0] = 7


def _array(**changes: object) -> bytes:
    entry = {"__ndarray__": True, "dtype": "<f4", "shape": [2], "data": b"\0" * 8} | changes
    return msgpack.packb({k: v for k, v in entry.items() if v != "absent"})


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (_array(dtype="|O"), "expected an array dtype out of |b1"),
        (_array(dtype="<U4"), "got '<U4'"),
        (_array(dtype=[["a", "<f4"]]), "expected an array dtype"),
        (_array(shape=[3]), "expected 12 bytes for an array .* got 8"),
        (_array(shape=[-2]), "shape"),
        (_array(shape=[2.0]), "shape"),
        (_array(shape=[True, 2]), "shape"),
        (_array(shape=[1] * 5), "at most 4 sizes"),
        (_array(shape=[1 << 20, 1 << 20], data=b""), "elements"),
        (_array(shape="2"), "shape"),
        (_array(data="text"), "got str"),
        (_array(data="absent"), "expected an array with the keys"),
        (_array(__ndarray__=1), "expected an array with the keys"),
        (_array(pickle=b"x"), "expected an array with the keys"),
        (_array(dtype="|b1", data=b"\x00\x02"), "expected 0 or 1 in a bool array, got the byte 2"),
        (b"", "not"),
        (b"\xc1", "not"),
        (pack([1]) + b"\x00", "not"),
        (b"\x82\xa1a\x01\xa1a\x02", "expected each key of a map once, got 'a' again"),
        (b"\x81\xc4\x01a\x01", "text as map keys, got b'a'"),
        (b"\x81\x01\x01", "not"),
        (b"\xc7\x01\x05x", "not"),
        (b"\xd6\xff\x00\x00\x00\x00", "not"),
        (b"\xdd\xff\xff\xff\xff", "not"),
        (b"\x91" * 20 + b"\xc0", "expected at most 8 levels"),
        (b"\x91" * 5000 + b"\xc0", "not"),
        (msgpack.packb([0] * (MAX_ITEMS + 1)), "not"),
        (msgpack.packb("x" * 70000), "not"),
        (b"\xa1\xff", "not"),
    ],
)
def test_hostile_bytes_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(ContractError, match="(?s)" + says.replace("|", r"\|")):
        unpack(data)


@pytest.mark.parametrize("value", [b"\xc0", b"\x90", b"\x80", b"\x81\xa1a\x01"])
def test_many_small_values_are_refused_before_they_fill_memory(value: bytes) -> None:
    data = b"\xdc\x04\x00" + 1024 * (b"\xdc\x03\xe8" + 1000 * value)
    tracemalloc.start()
    try:
        with pytest.raises(ContractError, match=f"at most {MAX_VALUES} lists, maps"):
            unpack(data)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


def test_a_length_that_is_claimed_allocates_nothing() -> None:
    tracemalloc.start()
    for claim in (b"\xc6\x7f\xff\xff\xff", b"\xdd\x7f\xff\xff\xff", b"\xdf\x7f\xff\xff\xff", b"\xdb\x7f\xff\xff\xff"):
        with pytest.raises(ContractError):
            unpack(claim + bytes(64))
    with pytest.raises(ContractError, match="expected a shape"):
        unpack(_array(shape=[1 << 25, 1 << 25]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MAX_REPLY_BYTES


@pytest.mark.parametrize("data", [bytes(1 << 20), pack({"k" * 60_000: {"__ndarray__": True}})])
def test_a_refusal_does_not_repeat_the_message(data: bytes) -> None:
    with pytest.raises(ContractError) as caught:
        unpack(data)
    assert len(str(caught.value)) < 1000


def test_size_bound() -> None:
    with pytest.raises(ContractError, match="at most"):
        unpack(bytes(MAX_REPLY_BYTES + 1), max_bytes=MAX_REPLY_BYTES)


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array(["a"]), np.array([None]), np.zeros(2, complex), 1 << 70])
def test_what_has_no_place_is_not_sent(value: object) -> None:
    with pytest.raises(ContractError, match="cannot be encoded"):
        pack({"value": value})
