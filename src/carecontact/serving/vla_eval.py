"""The client of vla-eval's model servers, protocol 1: HELLO both ways, the episode's start, one action for each
observation.

Arrays travel as on the native wire, so that its strict decoder serves here too. Pictures are sent as such arrays, which
a server accepts as well as PNG, and whose bytes do not depend on a library's version. Unlike the original client, this
one tells a server neither the task's number nor metrics: the start message holds the instruction only, the end message
nothing. The time stamp of every message is 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from carecontact.errors import ActionError, PolicyError
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.serving.cartesian import SETUPS, delta_card, libero_state
from carecontact.serving.client import ActReply, Client, sha256, unpacked
from carecontact.serving.connection import Connection
from carecontact.serving.dialect import joint_card, vla_eval_setup
from carecontact.serving.dialect_media import (
    DELTA_WIDTH,
    JOINTS,
    WIDTH,
    delta_actions,
    joint_actions,
    picture_of,
    setup_picture,
)
from carecontact.serving.packing import is_array, is_map, pack

PROTOCOL = 1
HELLO: dict[str, object] = {"harness_version": "carecontact", "protocol_version": PROTOCOL}
IMAGES = {"exterior": "exo_camera_1", "wrist": "wrist_camera"}
"""Our camera -> name of its picture, as in vla-eval's DROID benchmark; servers use their order."""
SPACES = {
    "joint_pos_abs": ("joint_position",),
    "joint_positions": ("joint_position",),
    "joint_velocity": ("droid_joint_velocity",),
    "raw": ("joint_position", "droid_joint_velocity"),
}
"""Format in the DimSpec of a server's joints -> our action spaces that may be meant."""
CERTAIN = ("joint_pos_abs", "joint_positions")
"""Formats that need no word of the address: ``joint_velocity`` states neither rad/s nor a normalisation, ``raw``
nothing."""
RAW_NAMES, RAW_DIMS = ("actions", "action", "joints"), (0, JOINTS, WIDTH)
"""Names and sizes of raw actions that may be seven joints, with or without the gripper; 0 is a size not stated."""
KEYS = {
    "hello": ("harness_version", "protocol_version"),
    "episode_start": ("task", "task.name"),
    "observation": ("images", "task_description", "states"),
    "episode_end": (),
}
"""Type of a message that is sent -> every key of its payload, besides the pictures (``images_of``)."""
ENVELOPE = ("type", "payload", "seq", "timestamp")
WANTS = ("send_wrist_image", "send_state")
"""What a server may request in its HELLO besides the exterior picture and the instruction."""
CANONICAL = "quat_no_antipodal"
"""What it may request besides for LIBERO: rotation vectors as robosuite has them."""
WITHOUT_EFFECT = ("seed", "env_seed")
"""What it may request of a simulator of LIBERO or SimplerEnv, and is for nothing here."""
DELTA_PARTS = {"position": 3, "rotation": 3, "gripper": 1}
"""Part of a specification of deltas -> its size."""
DELTA_ROW = ("actions", "action", "raw")


class VlaEvalClient(Client):
    """One trial with a model server of vla-eval."""

    _card: PolicyCard
    """Known from HELLO on."""

    def __init__(self, connection: Connection, *, options: Mapping[str, str]) -> None:
        """``options``: the options in the server's address."""
        super().__init__(connection)
        self._options = dict(options)
        self._seq = 0

    def card(self, *, deadline_s: float) -> PolicyCard:
        """Exchange HELLO and return the card. Raises PolicyError ``handshake`` for another protocol or action space."""
        payload = self._ask("hello", HELLO, "hello", deadline_s=deadline_s)
        version = payload.get("protocol_version")
        if version != PROTOCOL:
            raise PolicyError("handshake", f"hello: expected protocol_version {PROTOCOL}, got {version!r:.80}")
        self._card = _card(payload, self._options)
        return self._card

    def reset(self, instruction: str, session: Session, *, deadline_s: float) -> None:
        """Send the start. A server does not confirm it; if it fails, an error answers the first observation."""
        self.connection.expect_silence()
        self.connection.send(self._message("episode_start", {"task": {"name": instruction}}), deadline_s=deadline_s)

    def act(self, observation: Observation, *, deadline_s: float) -> ActReply:
        if (early := self.connection.waiting()) is not None:
            # A server refuses an episode's start with an error; nothing else may come unasked.
            _payload(early, "action", seq=0)
        payload = observation_payload(observation, self._card.cameras, self._card.arguments)
        answer = self._ask("observation", payload, "action", deadline_s=deadline_s)
        setup = SETUPS.get(self._card.arguments.get("profile", ""))
        try:
            if setup is not None:
                row = _row(answer, width=DELTA_WIDTH)
                actions = delta_actions(row, horizon=1, convention=setup.convention, grips=False)
            else:
                row = _row(answer, width=WIDTH)
                actions = joint_actions(row, horizon=1, space=self._card.action_space, grips=False)
        except ActionError as error:
            raise PolicyError("action", str(error)) from None
        return ActReply(actions=actions, sent=self._last, sent_sha256=sha256(self._last))

    def _end(self, *, deadline_s: float) -> None:
        self.connection.send(self._message("episode_end", {}), deadline_s=deadline_s)

    def _message(self, kind: str, payload: Mapping[str, object]) -> bytes:
        self._seq += 1
        self._last = message(kind, payload, seq=self._seq)
        return self._last

    def _ask(self, kind: str, payload: Mapping[str, object], answer: str, *, deadline_s: float) -> Mapping[str, object]:
        frame = self.connection.ask(self._message(kind, payload), answer, deadline_s=deadline_s)
        return _payload(frame, answer, seq=self._seq)


def message(kind: str, payload: Mapping[str, object], *, seq: int) -> bytes:
    """Encode a message. ``seq``: its number in the connection, from 1."""
    return pack({"type": kind, "payload": dict(payload), "seq": seq, "timestamp": 0.0})


def images_of(cameras: Sequence[str], arguments: Mapping[str, str]) -> dict[str, str]:
    """Return our camera -> name of its picture, for the cameras and the arguments of a card."""
    setup = SETUPS.get(arguments.get("profile", ""))
    names = IMAGES if setup is None else setup.vla_images
    return {camera: name for camera, name in names.items() if camera in cameras}


def observation_payload(
    observation: Observation, cameras: Sequence[str], arguments: Mapping[str, str]
) -> dict[str, object]:
    """Return what a server is shown of an observation, for the cameras and the arguments of its card. Raises
    ObservationError if a picture is missing."""
    names, setup = images_of(cameras, arguments), SETUPS.get(arguments.get("profile", ""))
    if setup is None:
        images = {name: picture_of(observation, camera) for camera, name in names.items()}
    else:
        look = {"orientation": arguments["orientation"], "hw": setup.vla_hw}
        images = {name: setup_picture(observation, camera, setup, **look) for camera, name in names.items()}
    payload: dict[str, object] = {"images": images, "task_description": observation.instruction}
    if arguments["state"] == "yes" and setup is not None:
        shortest = setup.vla_state is libero_state and arguments.get(CANONICAL) != "yes"
        payload["states"] = libero_state(observation, shortest=True) if shortest else setup.vla_state(observation)
    elif arguments["state"] == "yes":
        # 1 means closed, as in DROID's data.
        closed = 1.0 - np.asarray(observation.gripper_position, np.float64)
        payload["states"] = np.concatenate([observation.joint_position, closed]).astype("<f8")
    return payload


def _card(hello: Mapping[str, object], options: Mapping[str, str]) -> PolicyCard:
    wanted = hello.get("observation_params", {})
    if not is_map(wanted):
        raise PolicyError("handshake", f"observation_params: expected a map, got {wanted!r:.80}")
    chosen = vla_eval_setup(options)
    known = WANTS if chosen is None else (*WANTS, CANONICAL, *WITHOUT_EFFECT)
    strange = sorted(name for name, value in wanted.items() if name not in known and value not in (False, None))
    if strange:
        raise PolicyError(
            "handshake",
            f"observation_params: the server asks for {', '.join(strange):.200}, which is not sent; known: "
            f"{', '.join(known)}",
        )
    wrist, state = (bool(wanted.get(name, False)) for name in WANTS)
    if chosen is not None:
        return _delta_card(hello.get("action_spec") or {}, *chosen, wanted=wanted)
    space = _space(hello.get("action_spec") or {}, options.get("space"))
    arguments = {"dialect": "vla-eval", "space": space, "state": "yes" if state else "no"}
    return joint_card("vla-eval", space, ("exterior", "wrist") if wrist else ("exterior",), arguments)


def _delta_card(spec: object, profile: str, orientation: str, *, wanted: Mapping[str, object]) -> PolicyCard:
    """Raises PolicyError ``handshake`` for a specification that contradicts the profile."""
    setup, wrist = SETUPS[profile], bool(wanted.get(WANTS[0], False))
    if not is_map(spec):
        raise PolicyError("handshake", f"action_spec: expected a map, got {spec!r:.80}")
    formats = {"position": ("delta_xyz",), "rotation": setup.rotations, "gripper": setup.grippers}
    for name, part in spec.items():
        form, dims = (part.get("format"), part.get("dims")) if is_map(part) else (None, None)
        row = name in DELTA_ROW and form == "raw" and type(dims) is int and dims in (0, DELTA_WIDTH)
        if not row and (form not in formats.get(name, ()) or dims != DELTA_PARTS[name]):
            valid = ", ".join(f"{part} {' or '.join(names)}" for part, names in formats.items())
            raise PolicyError(
                "handshake",
                f"the server says that its actions have {name} ({dims!r:.20} of {form!r:.40}), and the profile "
                f"{profile} expects {valid}, or a raw row of {DELTA_WIDTH}; name another profile, or correct the spec",
            )
    if wrist and not setup.wrist:
        raise PolicyError("handshake", f"{WANTS[0]}: the profile {profile} has no wrist camera")
    arguments = {
        "dialect": "vla-eval",
        "profile": profile,
        "orientation": orientation,
        "state": "yes" if wanted.get(WANTS[1]) else "no",
    }
    if wanted.get(CANONICAL):
        arguments[CANONICAL] = "yes"
    return delta_card(f"vla-eval {profile}", setup, ("exterior", "wrist") if wrist else ("exterior",), arguments)


def _space(spec: object, named: str | None) -> str:
    """Return our action space for a server's specification of its actions. Raises PolicyError ``handshake`` if none
    fits, or several do."""
    if not is_map(spec):
        raise PolicyError("handshake", f"action_spec: expected a map, got {spec!r:.80}")
    parts = ", ".join(
        f"{name} ({part.get('dims')!r:.20} of {part.get('format')!r:.40})" if is_map(part) else f"{name!r:.40}"
        for name, part in sorted(spec.items())[:8]
    )
    says = f"the server says that its actions are {parts}" if parts else "the server does not say what its actions mean"
    spaces, certain = _meant(spec) if spec else (SPACES["raw"], False)
    if spec and set(spec) <= set(DELTA_PARTS) and "position (" not in parts.replace("position (3 of 'delta_xyz'", ""):
        raise PolicyError(
            "handshake",
            f"{says}: these are differences of the tool's pose, whose scale and frame no spec states; name the profile "
            f"in the address: ?profile={' or ?profile='.join(SETUPS)}",
        )
    if not spaces:
        *known, last = (repr(name) for name in SPACES if name != "raw")
        raise PolicyError(
            "handshake",
            f"{says}, which no action space here executes; expected joints ({JOINTS} of {', '.join(known)} or {last}) "
            "and nothing else but a gripper",
        )
    if named is not None and named not in spaces:
        remedy = "leave space out" if certain else f"?space={spaces[0]} would fit"
        raise PolicyError("handshake", f"{says}, but the address says ?space={named}; {remedy}")
    if named is None and not certain:
        only = "if it fits, " if len(spaces) == 1 else ""
        raise PolicyError(
            "handshake", f"{says}; {only}name the space in the address: ?space={' or ?space='.join(spaces)}"
        )
    return named or spaces[0]


def _meant(spec: Mapping[str, object]) -> tuple[tuple[str, ...], bool]:
    """Return which of our action spaces a specification may mean, and whether it states so by itself."""
    parts = [(name, part) for name, part in spec.items() if name != "gripper"]
    if len(parts) != 1 or not is_map(part := parts[0][1]):
        return (), False
    name, form, dims = parts[0][0], str(part.get("format")), part.get("dims")
    names, sizes = (RAW_NAMES, RAW_DIMS) if form == "raw" else (("joints",), (JOINTS,))
    known = name in names and isinstance(dims, int) and dims in sizes
    return SPACES.get(form, ()) if known else (), form in CERTAIN


def _payload(frame: bytes | str, kind: str, *, seq: int) -> Mapping[str, object]:
    entries = unpacked(frame, kind)
    payload = entries.get("payload") if is_map(entries) else None
    if not is_map(entries) or not is_map(payload) or set(entries) != set(ENVELOPE):
        raise PolicyError(
            "garbage", f"{kind}: expected a map with the keys {', '.join(ENVELOPE)}, got {entries!r:.200}"
        )
    if entries["type"] == "error":
        why = payload.get("error")
        raise PolicyError("exception", why if isinstance(why, str) and why.strip() else f"an error {payload!r:.200}")
    if entries["type"] != kind or entries["seq"] != seq:
        got = f"{entries['type']!r:.80} to message {entries['seq']!r:.40}"
        raise PolicyError("garbage", f"expected {kind!r} as the answer to message {seq}, got {got}")
    return payload


def _row(answer: Mapping[str, object], *, width: int) -> object:
    """Return the one action of an answer as an array (1, width). Raises ActionError if there is none.

    A server with one column less commands no gripper, which this benchmark ignores anyway.
    """
    chunk = answer.get("actions")
    if not is_array(chunk):
        raise ActionError(f"actions: expected an array, got {type(chunk).__name__} in the keys {sorted(answer)!s:.200}")
    row = chunk[None] if chunk.ndim == 1 else chunk
    if row.ndim == 2 and len(row) > 1:
        raise ActionError(
            f"actions: expected one action for each observation, got {len(row)}; set chunk_size=1 on the server"
        )
    if row.ndim == 2 and row.shape[1] == width - 1 and row.dtype.kind in "fiu":
        row = np.concatenate([row, np.zeros((len(row), 1), row.dtype)], 1)
    return row
