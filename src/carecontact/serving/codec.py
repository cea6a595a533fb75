"""Messages of the wire: observations, actions, cards and sessions as maps and back, with hints for a wrong answer."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NoReturn, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import ActionError, ContractError, ObservationError, PolicyError, did_you_mean
from carecontact.interface.action import MAX_CHUNK, Action, pose_shape_hint
from carecontact.interface.observation import MASK_NAMES, CameraView, Observation
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.interface.robot import ActionBounds, Compliance, Session
from carecontact.serving.packing import is_array, is_list, is_map, pack

Plain = dict[str, object]
Shape = tuple[int | str, ...]

OBSERVATION_ARRAYS: dict[str, tuple[str, Shape]] = {
    "joint_position": ("<f8", ("joints",)),
    "joint_velocity": ("<f8", ("joints",)),
    "gripper_position": ("<f8", (1,)),
    "pose_tcp_in_base": ("<f8", (7,)),
    "velocity_tcp_in_base": ("<f8", (6,)),
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
MASK: tuple[str, Shape] = ("|b1", ("H", "W"))
VIEW_TIME = "sim_time_s"
"""Field of a camera's view that is not sent: a view that is sent has the time of its observation."""
ALWAYS_IN_VIEW = ("intrinsics", "pose_camera_in_base")
ON_REQUEST = ("velocity_tcp_in_base",)
"""Arrays of an observation that are in a message only if the card requests them."""
MOST_UNKNOWN = 4
"""Most unknown keys of one map that an error message names."""
VECTORS = {
    "pose_tcp_in_base": "a list or array of 7 numbers (x y z [m], quaternion w x y z) or None",
    "delta": "a list or array of 6 numbers (translation, rotation) or None",
    "joint": "a list or array of numbers, one for each joint, or None",
    "wrench_in_tcp": "a list or array of 6 numbers (force [N], torque [N m]) or None",
}
"""Fields of an action that are arrays -> what each must be."""
ALWAYS = ("pose_tcp_in_base", "stiffness", "gripper", "done")
"""Fields that an encoded action has even if they are None; older clients expect them."""
OBJECT = "Action(pose_tcp_in_base=[x, y, z, qw, qx, qy, qz])"
PLAIN = '[{"pose_tcp_in_base": [x, y, z, qw, qx, qy, qz]}]'
CARD = 'PolicyCard(name="my-policy", modalities=("rgb",), cameras=("overhead",))'
"""Examples for error messages: of an action, of what travels in its place, and of a card."""


def act_message(observation: Observation) -> bytes:
    """Return the message of an observation. Raises ObservationError if the observation breaks the contract."""
    return pack({"type": "act", "observation": encode_observation(observation)})


def reset_message(instruction: str, session: Session) -> bytes:
    return pack({"type": "reset", "instruction": instruction, "session": encode_session(session)})


CLOSE = pack({"type": "close"})


def observation_sha256(observation: Observation) -> bytes:
    """Return the digest, 32 bytes, of the message that carries an observation, as recordings keep it.

    Give it to ``Episode`` as ``digest``, so that a loop of your own makes the recording that a trial would make.
    """
    return hashlib.sha256(act_message(observation)).digest()


def encode_observation(observation: Observation) -> Plain:
    """Encode an observation with the views that were taken for it; the other end has the earlier ones.

    Raises ObservationError for a field that does not fit its row, and for an unknown name.
    """
    plain = _fields(observation, Observation, ObservationError)
    plain = {name: value for name, value in plain.items() if value is not None or name not in ON_REQUEST}
    plain["cameras"] = {
        name: _fields(observation.cameras[name], CameraView, ObservationError) for name in sorted(observation.new)
    }
    for view in cast(dict[str, Plain], plain["cameras"]).values():
        del view[VIEW_TIME]
    decode_observation(plain)
    return plain


def decode_observation(plain: object) -> Observation:
    """Decode an observation. Raises ObservationError naming the field, what was expected and what came instead."""
    entries = _Value(plain, "observation", ObservationError).fields(Observation)
    sizes: dict[str, int] = {}
    given = [name for name in OBSERVATION_ARRAYS if name not in ON_REQUEST or entries[name].value is not None]
    arrays = {name: entries[name].array(OBSERVATION_ARRAYS[name], sizes) for name in given}
    return Observation(
        instruction=entries["instruction"].text(),
        sim_time_s=entries["sim_time_s"].number(),
        cameras={name: _camera(view) for name, view in entries["cameras"].named(CAMERAS, "camera").items()},
        **arrays,
    )


def _camera(view: _Value) -> CameraView:
    entries, sizes = view.fields(CameraView, absent=VIEW_TIME), dict[str, int]()
    given = [name for name in CAMERA_ARRAYS if name in ALWAYS_IN_VIEW or entries[name].value is not None]
    arrays = {name: entries[name].array(CAMERA_ARRAYS[name], sizes) for name in given}
    masks = None
    if entries["masks"].value is not None:
        named = entries["masks"].named(MASK_NAMES, "mask")
        masks = {name: mask.array(MASK, sizes) for name, mask in named.items()}
    return CameraView(masks=masks, **arrays)


def encode_actions(answer: object) -> list[object]:
    """Encode what ``act`` returned, one Action or a sequence of 1 to MAX_CHUNK, for the policy's end of the wire.

    Raises ActionError when it is neither, or when a field is of a wrong type.
    """
    actions: object = [answer] if isinstance(answer, Action) else answer
    hint = _object_hint(actions)
    if hint or not isinstance(actions, list | tuple):
        _Value(actions, "act", ActionError).refuse("an Action or a list of Actions", hint=hint)
    plain = plain_actions(cast(Sequence[object], actions))
    decode_actions(plain)
    return plain


def plain_actions(actions: Sequence[object]) -> list[object]:
    """Return actions as maps. Raises ActionError for what is no Action, and for an array that holds no numbers."""
    plain: list[object] = []
    for i, action in enumerate(actions):
        entries = _fields(action, Action, ActionError, place=f"act[{i}]")
        # Unused fields are left out: chunks are long, and most consist of poses only.
        entries = {name: value for name, value in entries.items() if value is not None or name in ALWAYS}
        for name, expected in VECTORS.items():
            if (value := entries.get(name)) is not None:
                with suppress(ValueError):
                    value = np.asarray(value)
                if not is_array(value) or value.dtype.kind not in "fiu":
                    _Value(value, f"act[{i}].{name}", ActionError).refuse(expected)
                entries[name] = value.astype(np.float64)
        look = entries.pop("look", ())
        if not isinstance(look, tuple | list) or look:
            entries["look"] = list(cast(tuple[object, ...], look)) if isinstance(look, tuple) else look
        if isinstance(entries["stiffness"], tuple):
            entries["stiffness"] = list(cast(tuple[object, ...], entries["stiffness"]))
        plain.append(entries)
    return plain


def decode_actions(plain: object) -> list[Action]:
    """Decode actions and check their types; ``Episode.step`` checks the values.

    Raises ActionError naming index and field, what was expected and what came instead.
    """
    hint = _plain_hint(plain)
    if hint or not is_list(plain):
        _Value(plain, "actions", ActionError).refuse("a list of maps", hint=hint)
    if not 1 <= len(plain) <= MAX_CHUNK:
        raise ActionError(f"actions: expected 1 to {MAX_CHUNK} actions, got {len(plain)}")
    return [_action(_Value(item, f"actions[{i}]", ActionError).fields(Action)) for i, item in enumerate(plain)]


def _action(entries: dict[str, _Value]) -> Action:
    given = {name: entry for name, entry in entries.items() if entry.value is not None}
    vectors = {name: given[name].vector(expected) for name, expected in VECTORS.items() if name in given}
    scalars = {name: given[name].number() for name in ("damping_ratio", "gripper") if name in given}
    stiffness = None
    if "stiffness" in given:
        items = given["stiffness"].items()
        if len(items) not in (2, 6):
            given["stiffness"].refuse("(translational, rotational), six numbers or None")
        stiffness = tuple(item.number() for item in items)
    done, look = entries["done"].flag(), entries["look"].names()
    return Action(**cast(dict[str, Any], {**vectors, **scalars}), stiffness=stiffness, done=done, look=look)


def encode_card(card: object) -> Plain:
    """Encode a card. Raises PolicyError ``handshake`` if it is no valid PolicyCard."""
    if not isinstance(card, PolicyCard):
        hint = f"; a policy shows a PolicyCard as its attribute 'card', for example card = {CARD}"
        if isinstance(card, Mapping):
            same = ", ".join(f"{key}={value!r}" for key, value in cast(Mapping[object, object], card).items())
            hint = f"; write card = PolicyCard({same:.200}) in place of the dict"
        raise PolicyError("handshake", f"card: expected a PolicyCard, got {type(card).__name__} {card!r:.80}{hint}")
    return card.plain()


def decode_card(plain: object) -> PolicyCard:
    """Decode a card. Raises PolicyError ``handshake`` naming the field, what was expected and what came instead."""
    try:
        whole = {"arguments": {}, "camera_hz": {}, **plain} if is_map(plain) else plain
        entries = _Value(whole, "card", ContractError).fields(PolicyCard)
        # The card checks the rest by itself.
        given: dict[str, Any] = {name: entry.value for name, entry in entries.items()}
        for name in ("name", "action_space", "delta", "control", "language_backend", "out_of_bounds"):
            given[name] = entries[name].text()
        for name in ("modalities", "cameras", "trained_on", "environment"):
            given[name] = entries[name].names()
        return PolicyCard(**given)
    except ContractError as error:
        raise PolicyError("handshake", str(error)) from None


def encode_session(session: Session) -> Plain:
    plain = _fields(session, Session, ContractError)
    plain["action_bounds"] = _fields(session.action_bounds, ActionBounds, ContractError)
    compliance = plain.pop("compliance")
    if compliance is not None:
        plain["compliance"] = _fields(compliance, Compliance, ContractError)
    decode_session(plain)
    # A session of an ideal arm is written as it always was.
    later = {"force_bias_n": 0.0, "joint_friction_nm": ()}
    return {name: value for name, value in plain.items() if name not in later or value != later[name]}


def decode_session(plain: object) -> Session:
    """Decode a session. Raises ContractError naming the field, what was expected and what came instead."""
    entries = _Value(plain, "session", ContractError).fields(Session)
    limits = entries["action_bounds"].fields(ActionBounds)
    bounds = {name: limit.numbers(3 if "workspace" in name else 2) for name, limit in limits.items()}
    sizes: dict[str, tuple[int, int]] = {}
    for name, size in entries["camera_sizes_px"].named(CAMERAS, "camera").items():
        width, height = size.numbers(2)
        if not (width.is_integer() and height.is_integer()):
            size.refuse("whole pixels")
        sizes[name] = (int(width), int(height))
    low = entries["joint_low_rad"].numbers(None)
    return Session(
        action_bounds=ActionBounds(**cast(dict[str, Any], bounds)),
        joint_low_rad=low,
        joint_high_rad=entries["joint_high_rad"].numbers(len(low)),
        camera_sizes_px=sizes,
        time_limit_s=entries["time_limit_s"].number(),
        compliance=None if entries["compliance"].value is None else _compliance(entries["compliance"]),
        force_bias_n=entries["force_bias_n"].number(),
        joint_friction_nm=entries["joint_friction_nm"].numbers(None),
    )


def _compliance(value: _Value) -> Compliance:
    entries = value.fields(Compliance)
    stiffness = entries.pop("stiffness").numbers(2)
    return Compliance(
        stiffness=cast(tuple[float, float], stiffness), **{name: entry.number() for name, entry in entries.items()}
    )


def _fields(value: object, kind: type[Any], error: type[ContractError], *, place: str = "") -> Plain:
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AO" else "a"
        _Value(value, place or kind.__name__, error).refuse(f"{article} {kind.__name__}")
    return {f.name: getattr(value, f.name) for f in dataclasses.fields(kind)}


@dataclasses.dataclass(frozen=True, slots=True)
class _Value:
    """A value of a message with its place there. Every method raises ``error`` for a value of another type."""

    value: object
    place: str
    error: type[ContractError]

    def refuse(self, expected: str, *, hint: str = "") -> NoReturn:
        """``hint``: what to send instead, as a clause after a semicolon."""
        shown = f"{type(self.value).__name__} {' '.join(repr(self.value).split()):.80}"
        if is_array(self.value):
            shown = f"an array {self.value.dtype} {self.value.shape}"
        raise self.error(f"{self.place}: expected {expected}, got {shown}{hint}")

    def fields(self, kind: type[Any], *, absent: str = "") -> dict[str, _Value]:
        """Return the entries of a map of the fields of ``kind``; those with a plain default may be absent, and the
        field ``absent`` must be."""
        if not is_map(self.value):
            self.refuse("a map")
        fields = {field.name: field.default for field in dataclasses.fields(kind) if field.name != absent}
        if unknown := sorted(self.value.keys() - fields.keys()):
            named = ", ".join(f"{key:.80}{did_you_mean(key, fields)}" for key in unknown[:MOST_UNKNOWN])
            raise self.error(f"{self.place}: unknown key {named}; valid: {', '.join(fields)}")
        for name, default in fields.items():
            if name not in self.value and default is dataclasses.MISSING:
                keys = ", ".join(sorted(self.value)) or "none"
                raise self.error(f"{self.place}: expected the key {name}, got {keys:.200}")
        entries = {**fields, **self.value}
        return {name: _Value(entries[name], f"{self.place}.{name}", self.error) for name in fields}

    def named(self, valid: Sequence[str], kind: str) -> dict[str, _Value]:
        """Return the entries of a map whose keys are names out of ``valid``."""
        if not is_map(self.value):
            self.refuse("a map")
        for name in self.value:
            if name not in valid:
                raise self.error(f"{self.place}: no {kind} {name!r}; valid: {', '.join(valid)}")
        return {name: _Value(value, f"{self.place}.{name}", self.error) for name, value in self.value.items()}

    def items(self) -> list[_Value]:
        """Return the entries of a list; none for anything else."""
        entries = self.value if is_list(self.value) else []
        return [_Value(entry, f"{self.place}[{i}]", self.error) for i, entry in enumerate(entries)]

    def text(self) -> str:
        return self.value if isinstance(self.value, str) else self.refuse("text")

    def names(self) -> tuple[str, ...]:
        """Return a list of texts, or the default of such a field."""
        names = list(cast(tuple[object, ...], self.value)) if isinstance(self.value, tuple) else self.value
        if not is_list(names) or not all(isinstance(n, str) for n in names):
            self.refuse("a list of names")
        return tuple(cast(list[str], names))

    def flag(self) -> bool:
        return self.value if isinstance(self.value, bool) else self.refuse("True or False")

    def number(self) -> float:
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            self.refuse("a number")
        try:
            return float(cast(float, value))
        except OverflowError:
            raise self.error(f"{self.place}: expected a number, got one too large for 64 bits") from None

    def numbers(self, count: int | None) -> tuple[float, ...]:
        """Return ``count`` finite numbers, or any: a tuple when encoding, a list when decoding."""
        items: object = list(cast(tuple[object, ...], self.value)) if isinstance(self.value, tuple) else self.value
        many = "" if count is None else f"{count} "
        if not is_list(items) or (count is not None and len(items) != count):
            self.refuse(f"{many}numbers")
        numbers = tuple(_Value(item, self.place, self.error).number() for item in items)
        return numbers if np.isfinite(numbers).all() else self.refuse(f"{many}finite numbers")

    def array(self, row: tuple[str, Shape], sizes: dict[str, int]) -> Any:
        """Return an array of the dtype and shape of the row; ``sizes`` are those of its letters and words so far."""
        (dtype, shape), value = row, self.value
        expected = f"{np.dtype(dtype).name} ({', '.join(map(str, shape))})"
        if not is_array(value):
            self.refuse(expected)
        fits = value.dtype == np.dtype(dtype) and value.ndim == len(shape)
        if not fits or any(
            got != (want if isinstance(want, int) else sizes.setdefault(want, got))
            for want, got in zip(shape, value.shape, strict=True)
        ):
            where = f" with {sizes}" if sizes else ""
            raise self.error(f"{self.place}: expected {expected}{where}, got {value.dtype.name} {value.shape}")
        return value

    def vector(self, expected: str) -> npt.NDArray[np.float64]:
        """Return an array of numbers, or a plain list of them, as clients in other languages send it, as an array."""
        value = self.value
        if is_list(value) and not any(isinstance(v, bool) or not isinstance(v, int | float) for v in value):
            return np.array(value, np.float64)
        if not is_array(value) or value.dtype.kind not in "fiu":
            self.refuse(
                expected, hint=pose_shape_hint(_shape(value)) if self.place.endswith(".pose_tcp_in_base") else ""
            )
        return value


# What a wrong answer may mean, and what to write instead: clauses after a semicolon, or nothing.


def _object_hint(answer: object) -> str:
    """Hint for what ``act`` returned in Python; empty if the answer may hold Actions."""
    if isinstance(answer, Mapping):
        return f"; return {OBJECT} in place of the dict"
    if isinstance(answer, list | tuple) and any(isinstance(item, Mapping) for item in cast(list[object], answer)):
        return f"; return [{OBJECT}, ...] in place of the dicts"
    shape = _shape(answer)
    if len(shape) == 1 and shape[0]:
        return f"{_width_hint(shape[0])}; return {OBJECT}, or Action(joint=...) for joints, in place of bare numbers"
    if len(shape) == 2:
        rows = "[Action(pose_tcp_in_base=row) for row in rows]"
        return f"{_width_hint(shape[1])}; return {rows}, or with joint=row for joints, in place of rows of numbers"
    return ""


def _plain_hint(answer: object) -> str:
    """Hint for the ``actions`` of a message; empty if they may be a list of maps."""
    if isinstance(answer, Mapping):
        return f"; put each action into a list, as in {PLAIN}"
    shape = _shape(answer)
    if (len(shape) == 1 and shape[0]) or len(shape) == 2:
        return f"{_width_hint(shape[-1])}; send a map for each action, as in {PLAIN}"
    return ""


def _width_hint(count: int) -> str:
    """Hint for a row of so many numbers, if it is neither a pose nor seven joint values."""
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
