"""The dialect of the servers of openpi, RoboArena and vllm-omni: one wire format, in which they differ by what they
send first.

A server sends its metadata as soon as the connection is open. Those of openpi are empty or describe no action space, so
that the address has to name a profile; those of RoboArena and vllm-omni describe what the server needs. After that,
every request is one map and its answer one frame. An error is a text frame (openpi, RoboArena) or ``{"type": "error"}``
(vllm-omni).
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from carecontact.errors import ActionError, PolicyError
from carecontact.interface.observation import U8, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import PANDA, Session
from carecontact.serving.cartesian import SETUPS, STATE
from carecontact.serving.client import ActReply, Client, reported, sha256, unpacked
from carecontact.serving.connection import Connection
from carecontact.serving.dialect import (
    CARTESIAN,
    ENDPOINT,
    GRIPPER,
    JOINTS,
    PROFILES,
    PROMPT,
    SESSION,
    Profile,
    announced_profile,
    card_of,
    contradiction,
    fitting,
    named_profile,
)
from carecontact.serving.dialect_media import (
    delta_actions,
    joint_actions,
    padded,
    picture_of,
    setup_picture,
    stretched,
)
from carecontact.serving.packing import OPENPI, is_array, is_map

HAND_TURN_RAD = -np.pi / 4
"""Angle of the hand about the flange's axis, as the franka description package mounts it."""
LATE = "; an openpi server sends its metadata first, unasked; other servers need another scheme in the address"
PACKED = "send one binary message, packed as openpi_client.msgpack_numpy does"
ERROR_WORDS = ("Traceback", "Error")
"""If a text that answers a reset begins so, it is an error and no confirmation."""

pack, unpack = OPENPI.pack, OPENPI.unpack


def new_session_id() -> str:
    """Return a random session id: a version-4 UUID of the operating system's generator, which depends on no seed."""
    return str(uuid.uuid4())


def infer_request(observation: Observation, profile: Profile, *, session_id: str) -> dict[str, object]:
    """Make the request for one observation. ``session_id``: sent only if the profile asks for it.

    Raises ObservationError if a picture that the profile's card requests is missing.
    """
    images = {key: _image(observation, camera, profile) for camera, key in profile.picture_keys.items()}
    if profile.setup:
        return {**images, STATE: SETUPS[profile.setup].state(observation), PROMPT: observation.instruction}
    joints = np.asarray(observation.joint_position, "<f8")
    # Our gripper reads 0 when it is closed, theirs 1.
    gripper = 1.0 - np.asarray(observation.gripper_position, "<f8")
    if not profile.endpoint:
        return {**images, JOINTS: joints, GRIPPER: gripper, PROMPT: observation.instruction}
    return {
        JOINTS: joints,
        CARTESIAN: cartesian_position(observation.pose_tcp_in_base),
        GRIPPER: gripper,
        PROMPT: observation.instruction,
        **images,
        **({SESSION: session_id} if profile.session else {}),
        ENDPOINT: "infer",
    }


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


def _image(observation: Observation, camera: str, profile: Profile) -> U8:
    if profile.setup and profile.image_hw is not None:
        setup = SETUPS[profile.setup]
        return setup_picture(observation, camera, setup, orientation=profile.orientation, hw=profile.image_hw)
    image = picture_of(observation, camera)
    if profile.endpoint or profile.image_hw is None:
        return stretched(image, profile.image_hw)
    return padded(image, profile.image_hw)


def digest(request: Mapping[str, object]) -> bytes:
    """Return the digest, 32 bytes, of a request without its random session id: equal trials have equal digests."""
    return sha256(pack({name: value for name, value in request.items() if name != SESSION}))


class OpenpiClient(Client):
    """One trial with a server of the openpi family."""

    _profile: Profile
    """Known from the metadata on."""

    def __init__(self, connection: Connection, *, scheme: str, options: Mapping[str, str]) -> None:
        """``scheme``: ``openpi`` or ``roboarena``; ``options``: those in the server's address."""
        super().__init__(connection)
        self._scheme, self._options = scheme, dict(options)
        self._session_id = new_session_id()

    def card(self, *, deadline_s: float) -> PolicyCard:
        """Receive the metadata and return the card.

        Raises PolicyError ``handshake`` if the metadata and the address together do not determine a profile.
        """
        metadata = _decoded(self.connection.receive("metadata", deadline_s=deadline_s, late=LATE), "metadata")
        if not is_map(metadata):
            raise PolicyError("handshake", f"metadata: expected a map, got {_shown(metadata)}; {PACKED}")
        self._profile = self._chosen(metadata)
        return card_of(self._profile)

    def _chosen(self, metadata: Mapping[str, object]) -> Profile:
        if "profile" in self._options:
            profile = named_profile(self._options)
            if wrong := contradiction(profile, metadata):
                raise PolicyError("handshake", f"{wrong}; {fitting(metadata)}")
            return profile
        if self._scheme == "openpi" and "action_space" not in metadata:
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

    def reset(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        """Ask for a reset. openpi's servers have none; the others then forget what they keep of the session.

        RoboArena confirms it with a text, vllm-omni with a map.
        """
        if not self._profile.endpoint:
            return
        frame = self.connection.ask(pack(reset_request(self._session_id)), "reset", deadline_s=deadline_s)
        answer = frame if isinstance(frame, str) else _decoded(frame, "reset")
        if isinstance(answer, str):
            if not answer.strip() or answer.lstrip().startswith(ERROR_WORDS):
                raise PolicyError("exception", reported(answer))
        elif not is_map(answer) or "status" not in answer:
            raise PolicyError("garbage", f"reset: expected a text or a map with status, got {_shown(answer)}")

    def act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        request = infer_request(observation, self._profile, session_id=self._session_id)
        message = pack(request)
        answer = _decoded(self.connection.ask(message, "actions", deadline_s=deadline_s), "actions")
        chunk = _chunk(answer)
        if self._profile.endpoint and is_array(chunk) and chunk.ndim == 1:
            chunk = chunk[None]  # One action, as for RoboArena's client.
        try:
            if setup := SETUPS.get(self._profile.setup):
                actions = delta_actions(chunk, horizon=self._profile.horizon, convention=setup.convention)
            else:
                actions = joint_actions(chunk, horizon=self._profile.horizon, space=self._profile.action_space)
        except ActionError as error:
            raise PolicyError("action", str(error)) from None
        return ActReply(actions=actions, sent=message, sent_sha256=digest(request))

    def _end(self, *, deadline_s: float) -> None:
        """Let the server forget the session; no answer is needed."""
        if self._profile.endpoint:
            self.connection.send(pack(reset_request(self._session_id)), deadline_s=deadline_s)


def _decoded(frame: bytes | str, what: str) -> object:
    """Decode a frame. Raises PolicyError ``exception`` for a reported error, ``garbage`` for what is no message."""
    if isinstance(frame, str):
        raise PolicyError("exception", reported(frame))
    message = unpacked(frame, what, packing=OPENPI, remedy=f"; {PACKED}")
    if is_map(message) and message.get("type") == "error":
        raise PolicyError("exception", reported(message.get("message")))
    return message


def _chunk(answer: object) -> object:
    """Return the actions in an answer. Raises PolicyError ``garbage`` if there are none."""
    if is_array(answer):
        return answer
    if not is_map(answer):
        raise PolicyError("garbage", f"expected actions in a map or an array, got {_shown(answer)}; {PACKED}")
    if "actions" not in answer:
        keys = ", ".join(sorted(answer)) or "none"
        raise PolicyError("garbage", f"expected a map with the key actions, got the keys {keys:.200}; {PACKED}")
    return answer["actions"]


def _shown(value: object) -> str:
    return f"an array {value.dtype} {value.shape}" if is_array(value) else f"{type(value).__name__} {value!r:.80}"
