"""Messages of the wire: observations, actions, cards and sessions as maps and back, with hints for a wrong answer."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError, ContractError, ObservationError, PolicyError, did_you_mean
from carecontact.interface.action import MAX_CHUNK, Action, pose_shape_hint
from carecontact.interface.observation import MASK_NAMES, CameraView, Observation
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.interface.robot import ActionBounds, Session
from carecontact.serving.packing import is_array, is_list, is_map, pack

# Hints for a policy whose card or answer is of a wrong type: what it may have meant, and what to write instead.

OBJECT = "Action(pose_tcp_in_base=[x, y, z, qw, qx, qy, qz])"
PLAIN = '[{"pose_tcp_in_base": [x, y, z, qw, qx, qy, qz]}]'
CARD = 'PolicyCard(name="my-policy", modalities=("rgb",), cameras=("overhead",))'


def object_hint(answer: object) -> str:
    """Return a hint for what ``act`` returned in Python: a clause after a semicolon; empty if the answer may hold
    Actions.
    """
    if isinstance(answer, Mapping):
        return f"; return {OBJECT} in place of the dict"
    if isinstance(answer, list | tuple) and any(isinstance(item, Mapping) for item in cast(list[object], answer)):
        return f"; return [{OBJECT}, ...] in place of the dicts"
    shape = _shape(answer)
    if len(shape) == 1 and shape[0]:
        return f"{_width(shape[0])}; return {OBJECT}, or Action(joint=...) for joints, in place of bare numbers"
    if len(shape) == 2:
        rows = "[Action(pose_tcp_in_base=row) for row in rows]"
        return f"{_width(shape[1])}; return {rows}, or with joint=row for joints, in place of rows of numbers"
    return ""


def plain_hint(answer: object) -> str:
    """Return a hint for the ``actions`` of a message: a clause after a semicolon; empty if they may be a list of
    maps.
    """
    if isinstance(answer, Mapping):
        return f"; put each action into a list, as in {PLAIN}"
    shape = _shape(answer)
    if (len(shape) == 1 and shape[0]) or len(shape) == 2:
        return f"{_width(shape[-1])}; send a map for each action, as in {PLAIN}"
    return ""


def pose_hint(value: object) -> str:
    """Return a hint for a value in the place of a pose: a clause after a semicolon, or empty."""
    return pose_shape_hint(_shape(value))


def card_hint(card: object) -> str:
    """Return a hint for a value in the place of a PolicyCard."""
    if isinstance(card, Mapping):
        given = cast(Mapping[object, object], card)
        same = ", ".join(f"{key}={value!r}" for key, value in given.items())
        return f"write card = PolicyCard({same:.200}) in place of the dict"
    return f"a policy shows a PolicyCard as its attribute 'card', for example card = {CARD}"


def _width(count: int) -> str:
    """Say what a row of so many numbers may be, if it is neither a pose nor seven joint values."""
    if count == 8:
        return "; eight numbers look like seven joints and a gripper: give the last one as gripper"
    return pose_shape_hint((count,)) if count == 6 else ""


def _shape(value: object) -> tuple[int, ...]:
    """Return the shape of a value that consists of numbers; () for anything else, also for rows of unequal length."""
    try:
        array = np.asarray(value)
    except Exception:
        # An answer may be of any class, and converting it may raise anything.
        return ()
    return array.shape if array.dtype.kind in "fiu" else ()


# Converts contract objects to plain values and back. One table says what each field must be, in both directions.

Plain = dict[str, object]
Shape = tuple[int | str, ...]

OBSERVATION_ARRAYS: dict[str, tuple[str, Shape]] = {
    "joint_position": ("<f8", ("joints",)),
    "joint_velocity": ("<f8", ("joints",)),
    "gripper_position": ("<f8", (1,)),
    "pose_tcp_in_base": ("<f8", (7,)),
}
CAMERA_ARRAYS: dict[str, tuple[str, Shape]] = {
    "intrinsics": ("<f8", (3, 3)),
    "pose_camera_in_base": ("<f8", (4, 4)),
    "rgb": ("|u1", ("H", "W", 3)),
    "depth": ("<f4", ("H", "W")),
    "points": ("<f4", ("N", 3)),
    "point_colors": ("|u1", ("N", 3)),
    "landmarks": ("<f4", (33, 3)),
    "landmarks_in_base": ("<f4", (33, 3)),
}
"""Field -> dtype and shape; equal letters within one camera, and equal words, stand for equal sizes."""
MOST_UNKNOWN = 4
"""Most unknown keys of one map that an error message names."""
VECTORS = {
    "pose_tcp_in_base": "a list or array of 7 numbers (x y z [m], quaternion w x y z) or None",
    "joint": "a list or array of numbers, one for each joint, or None",
    "wrench_in_tcp": "a list or array of 6 numbers (force [N], torque [N m]) or None",
}
"""Fields of an action that are arrays -> what each must be."""
_ALWAYS = ("pose_tcp_in_base", "stiffness", "gripper", "done")
"""Fields that an encoded action has even if they are None; older clients expect them."""
_MASK: tuple[str, Shape] = ("|b1", ("H", "W"))


def encode_observation(observation: Observation) -> Plain:
    """Encode an observation. Raises ObservationError if a field does not fit its row in the table, or a mask or camera
    has an unknown name.
    """
    plain = _fields(observation, Observation, ObservationError)
    plain["cameras"] = {
        name: _fields(observation.cameras[name], CameraView, ObservationError) for name in sorted(observation.cameras)
    }
    decode_observation(plain)
    return plain


def decode_observation(plain: object) -> Observation:
    """Decode an observation. Raises ObservationError naming the field, what was expected and what came instead."""
    entries = _known(plain, Observation, "observation", ObservationError)
    sizes: dict[str, int] = {}
    for name, row in OBSERVATION_ARRAYS.items():
        _check_array(entries[name], row, f"observation.{name}", sizes)
    instruction = entries["instruction"]
    if not isinstance(instruction, str):
        _wrong(ObservationError, "observation.instruction", "text", instruction)
    time_s = _number(entries["sim_time_s"], "observation.sim_time_s", ObservationError)
    cameras = entries["cameras"]
    if not is_map(cameras):
        _wrong(ObservationError, "observation.cameras", "a map", cameras)
    views: dict[str, CameraView] = {}
    for name, view in cameras.items():
        if name not in CAMERAS:
            raise ObservationError(f"observation.cameras: no camera {name!r}; valid: {', '.join(CAMERAS)}")
        views[name] = _decode_camera(view, f"observation.cameras.{name}")
    arrays = {name: entries[name] for name in OBSERVATION_ARRAYS}
    return Observation(instruction=instruction, sim_time_s=time_s, cameras=views, **cast(dict[str, Any], arrays))


def _decode_camera(plain: object, place: str) -> CameraView:
    entries = _known(plain, CameraView, place, ObservationError)
    sizes: dict[str, int] = {}
    for name, row in CAMERA_ARRAYS.items():
        if entries[name] is not None or name in ("intrinsics", "pose_camera_in_base"):
            _check_array(entries[name], row, f"{place}.{name}", sizes)
    masks = entries["masks"]
    if masks is not None:
        if not is_map(masks):
            _wrong(ObservationError, f"{place}.masks", "a map or None", masks)
        for name, mask in masks.items():
            if name not in MASK_NAMES:
                raise ObservationError(f"{place}.masks: no mask {name!r}; valid: {', '.join(MASK_NAMES)}")
            _check_array(mask, _MASK, f"{place}.masks.{name}", sizes)
    return CameraView(**cast(dict[str, Any], entries))


def encode_actions(answer: object) -> list[object]:
    """Encode what ``act`` returned, one Action or a sequence of 1 to MAX_CHUNK, for the policy's end of the wire.

    Raises ActionError when it is neither, or when a field is of a wrong type.
    """
    actions: object = [answer] if isinstance(answer, Action) else answer
    if not isinstance(actions, list | tuple):
        _wrong(ActionError, "act", "an Action or a list of Actions", actions, hint=object_hint(actions))
    if hint := object_hint(actions):
        _wrong(ActionError, "act", "an Action or a list of Actions", actions, hint=hint)
    plain = plain_actions(cast(Sequence[object], actions))
    decode_actions(plain)
    return plain


def plain_actions(actions: Sequence[object]) -> list[object]:
    """Return actions as maps. Raises ActionError for what is no Action, and for an array that holds no numbers."""
    plain: list[object] = []
    for i, action in enumerate(actions):
        entries = _fields(action, Action, ActionError, place=f"act[{i}]")
        # Unused fields are left out: chunks are long, and most consist of poses only.
        entries = {name: value for name, value in entries.items() if value is not None or name in _ALWAYS}
        for name, expected in VECTORS.items():
            if entries.get(name) is not None:
                entries[name] = _vector(entries[name], f"act[{i}].{name}", expected)
        if isinstance(entries["stiffness"], tuple):
            entries["stiffness"] = list(cast(tuple[object, ...], entries["stiffness"]))
        plain.append(entries)
    return plain


def _vector(value: object, place: str, expected: str) -> npt.NDArray[np.float64]:
    try:
        array = np.asarray(value)
    except ValueError:
        _wrong(ActionError, place, expected, value)
    if array.dtype.kind not in "fiu":
        _wrong(ActionError, place, expected, array)
    return array.astype(np.float64)


def decode_actions(plain: object) -> list[Action]:
    """Decode actions and check their types; ``Episode.step`` checks the values.

    Raises ActionError naming index and field, what was expected and what came instead.
    """
    hint = plain_hint(plain)
    if hint or not is_list(plain):
        _wrong(ActionError, "actions", "a list of maps", plain, hint=hint)
    if not 1 <= len(plain) <= MAX_CHUNK:
        raise ActionError(f"actions: expected 1 to {MAX_CHUNK} actions, got {len(plain)}")
    return [_decode_action(item, f"actions[{i}]") for i, item in enumerate(plain)]


def _decode_action(plain: object, place: str) -> Action:
    entries = _known(plain, Action, place, ActionError)
    vectors = {
        name: None if entries[name] is None else _numeric_array(entries[name], f"{place}.{name}", expected)
        for name, expected in VECTORS.items()
    }
    given = entries["stiffness"]
    stiffness: tuple[float, ...] | None = None
    if given is not None:
        if not is_list(given) or len(given) not in (2, 6):
            _wrong(ActionError, f"{place}.stiffness", "(translational, rotational), six numbers or None", given)
        stiffness = tuple(_number(v, f"{place}.stiffness[{i}]", ActionError) for i, v in enumerate(given))
    scalars = {
        name: None if entries[name] is None else _number(entries[name], f"{place}.{name}", ActionError)
        for name in ("damping_ratio", "gripper")
    }
    if type(entries["done"]) is not bool:
        _wrong(ActionError, f"{place}.done", "True or False", entries["done"])
    return Action(**cast(dict[str, Any], {**vectors, **scalars}), stiffness=stiffness, done=entries["done"])


def _numeric_array(value: object, place: str, expected: str) -> npt.NDArray[np.float64]:
    """Return an array of the wire, or a plain list of numbers as clients in other languages send it, as an array."""
    if is_list(value) and not any(isinstance(v, bool) or not isinstance(v, int | float) for v in value):
        return np.array(value, np.float64)
    if not is_array(value) or value.dtype.kind not in "fiu":
        hint = pose_hint(value) if place.endswith(".pose_tcp_in_base") else ""
        _wrong(ActionError, place, expected, value, hint=hint)
    return value


def encode_card(card: object) -> Plain:
    """Encode a card. Raises PolicyError ``handshake`` if it is no valid PolicyCard."""
    if not isinstance(card, PolicyCard):
        said = f"card: expected a PolicyCard, got {type(card).__name__} {card!r:.80}"
        raise PolicyError("handshake", f"{said}; {card_hint(card)}")
    plain = card.plain()
    decode_card(plain)
    return plain


def decode_card(plain: object) -> PolicyCard:
    """Decode a card. Raises PolicyError ``handshake`` naming the field, what was expected and what came instead."""
    try:
        entries = _known({"arguments": {}, **plain} if is_map(plain) else plain, PolicyCard, "card", ContractError)
        for name in ("name", "action_space", "control", "language_backend", "out_of_bounds"):
            if not isinstance(entries[name], str):
                _wrong(ContractError, f"card.{name}", "text", entries[name])
        for name in ("modalities", "cameras", "environment"):
            names = entries[name]
            if not is_list(names) or not all(isinstance(n, str) for n in names):
                _wrong(ContractError, f"card.{name}", "a list of names", names)
            entries[name] = tuple(names)
        arguments = entries["arguments"]
        if not is_map(arguments) or not all(isinstance(text, str) for text in arguments.values()):
            _wrong(ContractError, "card.arguments", "a map of names to texts", arguments)
        entries["control_hz"] = _number(entries["control_hz"], "card.control_hz", ContractError)
        return PolicyCard(**cast(dict[str, Any], entries))
    except ContractError as error:
        raise PolicyError("handshake", str(error)) from None


def encode_session(session: Session) -> Plain:
    plain = _fields(session, Session, ContractError)
    plain["action_bounds"] = _fields(session.action_bounds, ActionBounds, ContractError)
    decode_session(plain)
    return plain


def decode_session(plain: object) -> Session:
    """Decode a session. Raises ContractError naming the field, what was expected and what came instead."""
    entries = _known(plain, Session, "session", ContractError)
    bounds = _known(entries["action_bounds"], ActionBounds, "session.action_bounds", ContractError)
    lengths = {name: 3 if name.startswith("workspace") else 2 for name in bounds}
    limits = {n: _numbers(bounds[n], lengths[n], f"session.action_bounds.{n}") for n in bounds}
    sizes = entries["camera_sizes_px"]
    if not is_map(sizes):
        _wrong(ContractError, "session.camera_sizes_px", "a map", sizes)
    cameras: dict[str, tuple[int, int]] = {}
    for name, size in sizes.items():
        if name not in CAMERAS:
            raise ContractError(f"session.camera_sizes_px: no camera {name!r}; valid: {', '.join(CAMERAS)}")
        width, height = _numbers(size, 2, f"session.camera_sizes_px.{name}")
        if not (width.is_integer() and height.is_integer()):
            _wrong(ContractError, f"session.camera_sizes_px.{name}", "whole pixels", size)
        cameras[name] = (int(width), int(height))
    low = _numbers(entries["joint_low_rad"], None, "session.joint_low_rad")
    return Session(
        action_bounds=ActionBounds(**cast(dict[str, Any], limits)),
        joint_low_rad=low,
        joint_high_rad=_numbers(entries["joint_high_rad"], len(low), "session.joint_high_rad"),
        camera_sizes_px=cameras,
        time_limit_s=_number(entries["time_limit_s"], "session.time_limit_s", ContractError),
    )


def _fields(value: object, kind: type[Any], error: type[ContractError], *, place: str = "") -> Plain:
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AO" else "a"
        _wrong(error, place or kind.__name__, f"{article} {kind.__name__}", value)
    return {f.name: getattr(value, f.name) for f in dataclasses.fields(kind)}


def _known(plain: object, kind: type[Any], place: str, error: type[ContractError]) -> Plain:
    """Return a copy of a map that has every field of ``kind`` and no other key; fields with a plain default may be
    absent.
    """
    if not is_map(plain):
        _wrong(error, place, "a map", plain)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    unknown = sorted(set(plain) - set(fields))
    if unknown:
        named = ", ".join(f"{key:.80}{did_you_mean(key, fields)}" for key in unknown[:MOST_UNKNOWN])
        raise error(f"{place}: unknown key {named}; valid: {', '.join(fields)}")
    out: Plain = {}
    for name, field in fields.items():
        if name in plain:
            out[name] = plain[name]
        elif field.default is not dataclasses.MISSING:
            default = field.default
            out[name] = list(cast(tuple[object, ...], default)) if isinstance(default, tuple) else default
        else:
            raise error(f"{place}: expected the key {name}, got {', '.join(sorted(plain)) or 'none':.200}")
    return out


def _check_array(value: object, row: tuple[str, Shape], place: str, sizes: dict[str, int]) -> None:
    dtype, shape = row
    expected = f"{np.dtype(dtype).name} ({', '.join(map(str, shape))})"
    if not is_array(value):
        _wrong(ObservationError, place, expected, value)
    fits = value.dtype == np.dtype(dtype) and value.ndim == len(shape)
    if not fits or any(
        got != (want if isinstance(want, int) else sizes.setdefault(want, got))
        for want, got in zip(shape, value.shape, strict=True)
    ):
        where = f" with {sizes}" if sizes else ""
        raise ObservationError(f"{place}: expected {expected}{where}, got {value.dtype.name} {value.shape}")


def _number(value: object, place: str, error: type[ContractError]) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        _wrong(error, place, "a number", cast(object, value))
    try:
        return float(cast(float, value))
    except OverflowError:
        raise error(f"{place}: expected a number, got one too large for 64 bits") from None


def _numbers(value: object, count: int | None, place: str) -> tuple[float, ...]:
    """Return a value as ``count`` numbers, or any. ``value``: a tuple when encoding, a list when decoding."""
    items: object = list(cast(tuple[object, ...], value)) if isinstance(value, tuple) else value
    many = "" if count is None else f"{count} "
    if not is_list(items) or (count is not None and len(items) != count):
        _wrong(ContractError, place, f"{many}numbers", items)
    numbers = tuple(_number(v, place, ContractError) for v in items)
    if not np.isfinite(numbers).all():
        _wrong(ContractError, place, f"{many}finite numbers", items)
    return numbers


def _wrong(error: type[ContractError], place: str, expected: str, got: object, *, hint: str = "") -> NoReturn:
    """Raise ``error`` for a wrong value. ``hint``: what to send instead, as a clause after a semicolon."""
    said = f"an array {got.dtype} {got.shape}" if is_array(got) else f"{type(got).__name__} {_in_one_line(got)}"
    raise error(f"{place}: expected {expected}, got {said}{hint}")


def _in_one_line(value: object) -> str:
    return f"{' '.join(repr(value).split()):.80}"


# The messages that the harness sends.

CLOSE = pack({"type": "close"})


def reset_message(instruction: str, session: Session) -> bytes:
    return pack({"type": "reset", "instruction": instruction, "session": encode_session(session)})


def act_message(observation: Observation) -> bytes:
    """Return the message that carries an observation. Raises ObservationError if the observation breaks the
    contract.
    """
    return pack({"type": "act", "observation": encode_observation(observation)})


def observation_sha256(observation: Observation) -> bytes:
    """Return the digest, 32 bytes, of the message that carries an observation, as recordings keep it.

    Give it to ``Episode`` as ``digest``, so that a loop of your own makes the recording that a trial would make.
    """
    return hashlib.sha256(act_message(observation)).digest()
