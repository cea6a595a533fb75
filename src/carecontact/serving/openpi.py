"""The dialect of openpi's servers: its packing of arrays, its requests, and the client."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping
from typing import cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from carecontact.errors import ActionError, ContractError, ObservationError, PolicyError
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import PANDA, Session
from carecontact.serving.client import ActReply, Client, sha256
from carecontact.serving.connection import Connection
from carecontact.serving.dialect import (
    CARTESIAN,
    ENDPOINT,
    GRIPPER,
    JOINTS,
    PROFILES,
    PROMPT,
    SESSION,
    WRIST,
    Profile,
    announced_profile,
    card_of,
    contradiction,
    describes_itself,
    fitting,
    named_profile,
)
from carecontact.serving.dialect_media import U8, cropped_16_9, joint_actions, padded, stretched
from carecontact.serving.packing import (
    DTYPES,
    MAX_DEPTH,
    MAX_REPLY_BYTES,
    array_of,
    is_array,
    is_list,
    is_map,
    msgpack_of,
)

# openpi's packing: msgpack in which an array is a map with *bytes* as keys, decoded as strictly as the native wire's.
#
# An array is ``{b"__ndarray__": true, b"data": <bin>, b"dtype": "<f4", b"shape": [15, 8]}``, a scalar of numpy
# ``{b"__npgeneric__": true, b"data": 0.5, b"dtype": "<f4"}``. The layout is that of openpi-client 0.1.2, module
# msgpack_numpy.

ARRAY, SCALAR = b"__ndarray__", b"__npgeneric__"
KEYS = {ARRAY: {ARRAY, b"data", b"dtype", b"shape"}, SCALAR: {SCALAR, b"data", b"dtype"}}
"""Marker -> the keys of a map with this marker, which stands for an array or a scalar of numpy."""

_packb = cast(Callable[..., bytes], msgpack.packb)  # pyright: ignore[reportUnknownMemberType]


def pack(value: object) -> bytes:
    """Encode maps with text keys, lists, numbers, text, None and numeric arrays. Equal values give equal bytes.

    Raises ContractError for anything else.
    """
    try:
        return _packb(value, default=_to_map)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ContractError(f"message: expected what can be sent, got what cannot be encoded: {error}") from None


def unpack(data: bytes, *, max_bytes: int = MAX_REPLY_BYTES) -> object:
    """Decode one message. Arrays come back read only, scalars of numpy as numbers.

    Raises ContractError: not msgpack, trailing bytes, a size, depth or count over its bound, a repeated key, a key that
    is neither text nor one of an array, an array whose dtype is not one of DTYPES or whose data does not fill its
    shape.
    """
    return _with_arrays(msgpack_of(data, max_bytes=max_bytes, pairs=_map), depth=0, place="message")


def _to_map(value: object) -> object:
    if is_array(value):
        if value.dtype.str not in DTYPES:
            raise TypeError(f"array dtype {value.dtype}; valid: {', '.join(DTYPES)}")
        return {ARRAY: True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": list(value.shape)}
    raise TypeError(f"a {type(value).__name__} has no place in a message")


def _map(pairs: list[tuple[object, object]]) -> dict[object, object]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        raise ContractError("message: expected each key of a map once, got one of them again")
    for marker, keys in KEYS.items():
        if marker in entries:
            if set(entries) != keys or entries[marker] is not True:
                raise ContractError(f"message: expected {marker!r} with the keys {sorted(keys)}, got {pairs!r:.200}")
            return entries
    for key in entries:
        if not isinstance(key, str):
            raise ContractError(f"message: expected text as keys outside arrays, got {key!r:.80}")
        if key.encode() in KEYS:
            hint = "pack with openpi_client.msgpack_numpy, which packs its own keys as bytes"
            raise ContractError(f"message: expected {key.encode()!r} as the mark of an array, got text; {hint}")
    return entries


def _with_arrays(value: object, *, depth: int, place: str) -> object:
    if depth > MAX_DEPTH:
        raise ContractError(f"{place:.80}: expected at most {MAX_DEPTH} levels, got a deeper one")
    if is_map(value):
        entries = cast(dict[object, object], value)
        if ARRAY in entries:
            return array_of(entries[b"dtype"], entries[b"shape"], entries[b"data"], place=place)
        if SCALAR in entries:
            return _number(entries[b"data"], entries[b"dtype"], place)
        return {k: _with_arrays(v, depth=depth + 1, place=f"{place}.{k:.80}") for k, v in value.items()}
    if is_list(value):
        return [_with_arrays(v, depth=depth + 1, place=f"{place}[{i}]") for i, v in enumerate(value)]
    return value


def _number(data: object, dtype: object, place: str) -> object:
    if dtype not in DTYPES or not isinstance(data, bool | int | float):
        raise ContractError(
            f"{place}: expected a number of one of {', '.join(DTYPES)}, got {data!r:.80} of {dtype!r:.80}"
        )
    try:
        with np.errstate(over="ignore"):
            return cast(object, np.dtype(cast(str, dtype)).type(data).item())
    except OverflowError:
        raise ContractError(f"{place}: expected a number of {dtype}, got {data!r:.80}") from None


# Makes the requests of the openpi family from an observation, key by key.

HAND_TURN_RAD = -np.pi / 4
"""Angle of the hand about the flange's axis, as the franka description package mounts it."""


def new_session_id() -> str:
    """Return a random session id: a version-4 UUID of the operating system's generator, which depends on no seed."""
    return str(uuid.uuid4())


def infer_request(observation: Observation, profile: Profile, *, session_id: str) -> dict[str, object]:
    """Make the request for one observation. ``session_id``: sent only if the profile asks for it.

    Raises ObservationError if a picture that the profile's card requests is missing.
    """
    images: dict[str, object] = {
        key: _image(observation, camera, profile) for camera, key in profile.exterior_keys.items()
    }
    if profile.wrist:
        images[WRIST] = _image(observation, "wrist", profile)
    joints = np.asarray(observation.joint_position, "<f8")
    gripper = _theirs(np.asarray(observation.gripper_position, "<f8"), profile)
    if not profile.endpoint:
        return {**images, JOINTS: joints, GRIPPER: gripper, PROMPT: observation.instruction}
    request: dict[str, object] = {
        JOINTS: joints, CARTESIAN: cartesian_position(observation.pose_tcp_in_base), GRIPPER: gripper,
        PROMPT: observation.instruction, **images,
    }  # fmt: skip
    if profile.session:
        request[SESSION] = session_id
    return {**request, ENDPOINT: "infer"}


def reset_request(session_id: str) -> dict[str, object]:
    return {SESSION: session_id, ENDPOINT: "reset"}


def cartesian_position(pose_tcp_in_base: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Turn the pose (7,) of our tool into DROID's pose (6,) of the flange (panda_link8): position [m] and Euler angles
    [rad] about the fixed axes x, y, z.
    """
    hand = Rotation.from_quat(pose_tcp_in_base[3:], scalar_first=True)
    position = pose_tcp_in_base[:3] - PANDA.tcp_z_m * hand.as_matrix()[:, 2]
    flange = hand * Rotation.from_euler("z", -HAND_TURN_RAD)
    return np.array([*position, *flange.as_euler("xyz")], "<f8")


def _theirs(opening: npt.NDArray[np.float64], profile: Profile) -> npt.NDArray[np.float64]:
    """Convert our gripper opening, where 0 is closed, to the server's convention."""
    return profile.closed_gripper + (1.0 - 2.0 * profile.closed_gripper) * opening


def _image(observation: Observation, camera: str, profile: Profile) -> U8:
    view = observation.cameras.get(camera)
    if view is None or view.rgb is None:
        raise ObservationError(f"observation.cameras.{camera}.rgb: expected a picture, got none")
    image = cropped_16_9(view.rgb)
    if profile.resize == "stretch":
        return stretched(image, profile.image_hw)
    assert profile.image_hw is not None
    return padded(image, profile.image_hw)


# The client of the servers of openpi, RoboArena and vllm-omni. They share one wire format and differ in what they send
# first.
#
# A server sends its metadata as soon as the connection is open. Those of openpi are empty or describe no action space,
# so that the address has to name a profile; those of RoboArena and vllm-omni describe what the server needs. After
# that, every request is one map and its answer one frame. An error is a text frame (openpi, RoboArena) or ``{"type":
# "error"}`` (vllm-omni).

LATE = "; an openpi server sends its metadata first, unasked; other servers need another scheme in the address"
PACKED = "send one binary message, packed as openpi_client.msgpack_numpy does"
ERROR_WORDS = ("Traceback", "Error")
"""If a text that answers a reset begins so, it is an error and no confirmation."""


class OpenpiClient(Client):
    """One trial with a server of the openpi family."""

    def __init__(self, connection: Connection, *, scheme: str, options: Mapping[str, str]) -> None:
        """
        Args:
            scheme: ``openpi`` or ``roboarena``.
            options: the options in the server's address.
        """
        super().__init__(connection)
        self._scheme, self._options = scheme, dict(options)
        self._session_id = new_session_id()
        self._profile: Profile | None = None

    def card(self, *, deadline_s: float) -> PolicyCard:
        """Receive the metadata and return the card.

        Raises PolicyError ``handshake`` if the metadata and the address together do not determine a profile.
        """
        frame = self.connection.receive("metadata", deadline_s=deadline_s, late=LATE)
        metadata = _decoded(frame, "metadata")
        if not is_map(metadata):
            raise PolicyError("handshake", f"metadata: expected a map, got {_shown(metadata)}; {PACKED}")
        self._profile = self._chosen(metadata)
        told = self._profile.endpoint
        return card_of(self._profile, dialect="roboarena" if told else "openpi")

    def _chosen(self, metadata: Mapping[str, object]) -> Profile:
        if "profile" not in self._options:
            if self._scheme == "openpi" and not describes_itself(metadata):
                keys = f"only {', '.join(sorted(metadata)):.200}" if metadata else "nothing"
                raise PolicyError(
                    "handshake",
                    f"the server says {keys} of itself: neither action space nor pictures. Name the profile that "
                    f"it was trained for in the address: ?profile={' or ?profile='.join(PROFILES)}",
                )
            if "horizon" in self._options:
                raise PolicyError(
                    "handshake",
                    "horizon: a server that describes itself has all its actions executed; leave horizon out, or name "
                    "a profile",
                )
            return announced_profile(metadata, self._options)
        profile = named_profile(self._options)
        if wrong := contradiction(profile, metadata):
            raise PolicyError("handshake", f"{wrong}; {fitting(metadata)}")
        return profile

    def _begin(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        """Ask for a reset. openpi's servers have none; the others then forget what they keep of the session."""
        if self._known.endpoint:
            frame = self.connection.ask(pack(reset_request(self._session_id)), "reset", deadline_s=deadline_s)
            _confirmed(frame)

    def _act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        profile = self._known
        request = infer_request(observation, profile, session_id=self._session_id)
        message = pack(request)
        answer = _decoded(self.connection.ask(message, "actions", deadline_s=deadline_s), "actions")
        try:
            actions = joint_actions(
                _chunk(answer, single=profile.endpoint), horizon=profile.horizon, space=profile.action_space
            )
        except ActionError as error:
            raise PolicyError("action", str(error)) from None
        return ActReply(actions=actions, sent=message, sent_sha256=digest(request))

    def _end(self, *, deadline_s: float) -> None:
        """Tell the server that the session has ended, so that it can forget it; no answer is needed."""
        if self._profile is not None and self._profile.endpoint:
            self.connection.send(pack(reset_request(self._session_id)), deadline_s=deadline_s)

    @property
    def _known(self) -> Profile:
        if self._profile is None:
            raise ContractError("OpenpiClient: expected card before it, got none")
        return self._profile


def digest(request: Mapping[str, object]) -> bytes:
    """Return the digest, 32 bytes, of a request without its random session id, so that equal trials have equal
    digests.
    """
    return sha256(pack({name: value for name, value in request.items() if name != SESSION}))


def _decoded(frame: bytes | str, what: str) -> object:
    """Decode a frame. Raises PolicyError ``exception`` for an error that the server reports, ``garbage`` for any other
    frame that is no message.
    """
    if isinstance(frame, str):
        raise PolicyError("exception", _told(frame))
    try:
        message = unpack(frame)
    except ContractError as error:
        raise PolicyError("garbage", f"{what} {error}; {PACKED}") from None
    if is_map(message) and message.get("type") == "error":
        raise PolicyError("exception", _told(message.get("message")))
    return message


def _told(error: object) -> str:
    if isinstance(error, str) and error.strip():
        return error
    return f"the policy's server reported an error, expected its reason as text, got {error!r:.80}"


def _confirmed(frame: bytes | str) -> None:
    """Check the answer to a reset: RoboArena confirms it with a text, vllm-omni with a map."""
    answer = frame if isinstance(frame, str) else _decoded(frame, "reset")
    if isinstance(answer, str):
        if not answer.strip() or answer.lstrip().startswith(ERROR_WORDS):
            raise PolicyError("exception", _told(answer))
    elif not is_map(answer) or "status" not in answer:
        raise PolicyError("garbage", f"reset: expected a text or a map with status, got {_shown(answer)}")


def _chunk(answer: object, *, single: bool) -> object:
    """Return the array of actions in an answer. Raises PolicyError ``garbage`` if there is none.

    ``single``: whether an array with one axis counts as one action, as for RoboArena's client.
    """
    if is_map(answer):
        if "actions" not in answer:
            keys = ", ".join(sorted(answer)) or "none"
            raise PolicyError("garbage", f"expected a map with the key actions, got the keys {keys:.200}; {PACKED}")
        answer = answer["actions"]
    elif not is_array(answer):
        raise PolicyError("garbage", f"expected actions in a map or an array, got {_shown(answer)}; {PACKED}")
    return answer[None] if single and is_array(answer) and answer.ndim == 1 else answer


def _shown(value: object) -> str:
    return f"an array {value.dtype} {value.shape}" if is_array(value) else f"{type(value).__name__} {value!r:.80}"
