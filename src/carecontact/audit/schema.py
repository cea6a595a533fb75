"""Part (e) tests whether a policy gets what its card names, in the interface's schema and in the exact keys of a
dialect, and nothing more."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from carecontact.audit.finding import PRIVILEGED, Finding, Part, findings
from carecontact.audit.watched import Watched
from carecontact.errors import CarecontactError, ContractError
from carecontact.interface.policy import PolicyCard
from carecontact.recording.reason import reason
from carecontact.serving import codec, dialect_media, vla_eval
from carecontact.serving.cartesian import STATE, STATE_WIDTH
from carecontact.serving.dialect import CARTESIAN, ENDPOINT, GRIPPER, JOINTS, PROMPT, SESSION, profile_of
from carecontact.serving.packing import unpack
from carecontact.serving.sent_message import dialect_of, unpacked_message

Found = Iterator[tuple[str, str]]
"""Pairs of a place in a message and what is wrong there."""
RANDOM_ID = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}")
"""A UUID of version 4, which consists of random bits and can therefore reveal nothing."""
NUMBERS = {JOINTS: (dialect_media.JOINTS,), GRIPPER: (1,), CARTESIAN: (6,), STATE: (STATE_WIDTH,)}
"""Key of a message of openpi's family -> shape of its array of type ``<f8``."""


def check_conversation(messages: Sequence[bytes], card: PolicyCard, *, instruction: str) -> list[tuple[str, str]]:
    """Return pairs of a place and what is wrong there, for all messages of one trial in the order of sending."""
    dialect = dialect_of(card.arguments)
    found: list[tuple[str, str]] = []
    sessions: set[str] = set()
    for number, message in enumerate(messages, start=1):
        try:
            entries = unpacked_message(message, dialect)
        except CarecontactError as error:
            found.append((f"message {number}", str(error)))
            continue
        if not isinstance(entries, dict):
            found.append((f"message {number}", f"expected a map, got {type(entries).__name__}"))
        elif dialect == "vla-eval":
            found += _vla_eval(entries, card, instruction=instruction, number=number)
        else:
            found += _openpi(entries, card, instruction=instruction)
            sessions |= {str(entries[SESSION])} if SESSION in entries else set()
    if len(sessions) > 1:
        found.append((SESSION, f"{len(sessions)} of them in one trial"))
    return found


def _openpi(entries: dict[str, Any], card: PolicyCard, *, instruction: str) -> Found:
    profile = profile_of(card.arguments)
    resets = profile.endpoint and entries.get(ENDPOINT) == "reset"
    place = "reset" if resets else "request"
    yield from _keys(entries, (SESSION, ENDPOINT) if resets else profile.keys, place)
    for key, value in entries.items():
        if key in NUMBERS:
            yield from _array(value, "<f8", NUMBERS[key], f"{place}.{key}")
        elif key == SESSION and not RANDOM_ID.fullmatch(str(value)):
            yield f"{place}.{key}", f"expected a random UUID, got {value!r:.80}"
        elif key == PROMPT and value != instruction:
            yield f"{place}.{key}", f"expected the instruction, got {value!r:.80}"
        elif key == ENDPOINT and value not in ("infer", "reset"):
            yield f"{place}.{key}", f"expected infer or reset, got {value!r:.80}"
        elif key in (SESSION, PROMPT, ENDPOINT):
            continue
        elif key in profile.keys:
            yield from _array(value, "|u1", (*(profile.image_hw or (288, 512)), 3), f"{place}.{key}")


def _vla_eval(entries: dict[str, Any], card: PolicyCard, *, instruction: str, number: int) -> Found:
    yield from _keys(entries, vla_eval.ENVELOPE, "message")
    kind, payload = entries.get("type"), entries.get("payload")
    expected = {1: "hello", 2: "episode_start"}.get(number, "observation")
    if kind != expected and not (kind == "episode_end" and number > 2):
        yield "message.type", f"expected {expected}, got {kind!r:.80}"
    for name, value in (("seq", number), ("timestamp", 0.0)):
        if type(entries.get(name)) is not type(value) or entries.get(name) != value:
            yield f"message.{name}", f"expected {value}, got {entries.get(name)!r:.80}"
    if not isinstance(payload, dict) or kind not in vla_eval.KEYS:
        yield "message.payload", f"expected a map, got {payload!r:.80}"
        return
    pictures = [f"images.{name}" for name in vla_eval.images_of(card.cameras, card.arguments).values()]
    allowed = {*vla_eval.KEYS[kind], *(pictures if kind == "observation" else ())}
    allowed -= {"states"} if card.arguments.get("state") != "yes" else set[str]()
    yield from _keys(_paths(payload), sorted(allowed), kind)
    for place, value in _paths(payload).items():
        where = f"{kind}.{place}"
        if place in ("task_description", "task.name") and value != instruction:
            yield where, f"expected the instruction, got {value!r:.80}"
        elif place in vla_eval.HELLO and value != vla_eval.HELLO[place]:
            yield where, f"expected {vla_eval.HELLO[place]!r}, got {value!r:.80}"
        elif place == "states":
            yield from _array(value, "<f8", (dialect_media.WIDTH,), where)
        elif place in pictures:
            yield from _array(value, "|u1", (None, None, 3), where)


def _keys(entries: Mapping[str, object], allowed: Sequence[str], place: str) -> Found:
    """Yield the keys of a message that are not on the list, and those on the list that the message lacks."""
    for key in sorted(entries.keys() - set(allowed)):
        secret = " and holds a word of privileged information" if any(word in key for word in PRIVILEGED) else ""
        yield f"{place}.{key}", f"this key is not on the dialect's list{secret}; no policy may receive it"
    for key in sorted(set(allowed) - entries.keys()):
        yield f"{place}.{key}", "is missing"


def _array(value: object, dtype: str, shape: tuple[int | None, ...], place: str) -> Found:
    expected = f"expected {np.dtype(dtype).name} {shape}"
    if not isinstance(value, np.ndarray):
        yield place, f"{expected}, got {value!r:.80}"
    elif (
        value.dtype != np.dtype(dtype)
        or value.ndim != len(shape)
        or any(want not in (None, got) for want, got in zip(shape, value.shape, strict=True))
    ):
        yield place, f"{expected}, got {value.dtype} {value.shape}"


def _paths(value: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Return every map in a value, and every leaf of these maps, by its path."""
    out: dict[str, Any] = {}
    for key, inner in value.items():
        out[f"{place}{key}"] = inner
        if isinstance(inner, dict):
            out |= _paths(inner, f"{place}{key}.")
    return out


FIELDS_OF = {
    "rgb": {"rgb"},
    "depth": {"depth"},
    "points": {"points", "point_colors"},
    "masks": {"masks"},
    "landmarks": {"landmarks", "landmarks_in_base"},
}
"""Modality -> fields of a camera's view that it fills."""
ALWAYS = {"intrinsics", "pose_camera_in_base"}
MESSAGE = {"type", "observation"}
_REFUSED = re.compile(r"\b(observation(?:\.\w+)*): unknown key (\w+(?:, \w+)*)")
"""Matches the codec's error at the policy's end. The codec does not return the refused message, so its keys are read
from the error."""


def audit_schema(trials: list[Watched]) -> Part:
    """``trials``: real trials of the audited policies, with their observations still in memory."""
    leaks: list[Finding] = []
    messages = 0
    for trial in trials:
        if trial.error:
            failed = f"the trial failed, so the audit did not see all of its messages: {reason(trial.error)}"
            leaks += findings(trial.policy, ((place, failed) for place in failed_at(trial.error)))
        card = trial.card
        if card is not None and dialect_of(card.arguments):
            sent = [message for message in trial.sent if message]
            messages += len(sent)
            leaks += findings(trial.policy, check_conversation(sent, card, instruction=trial.instruction))
            continue
        messages += len(trial.looks)
        step_s = 0.0 if trial.recording is None else trial.recording.header.spec.protocol.physics.dt_s
        timetable = Timetable(card, early_s=step_s)
        for look in trial.looks:
            due = timetable.due(look.time_s, look.asked)
            leaks += findings(trial.policy, check_message(look.sent, card, joints=trial.joints, due=due))
    counts = {"trials": len(trials), "messages": messages}
    return Part(name="schema", counts=counts, findings=tuple(dict.fromkeys(leaks)))


def failed_at(error: str) -> list[str]:
    """Return the keys that the policy's end refused, if its trial failed for that reason; otherwise ``trial``."""
    refused = _REFUSED.search(reason(error))
    return ["trial"] if refused is None else [f"{refused[1]}.{key}" for key in refused[2].split(", ")]


class Timetable:
    """Which cameras the observations of one trial may show, by the card and by what the policy asked for: by other code
    than that which took the views."""

    def __init__(self, card: PolicyCard | None, *, early_s: float) -> None:
        """``early_s``: by how much less an observation may come before its time, because control periods are whole
        physics steps: the length of a step [s]."""
        self._early_s = early_s - 1e-6
        self._cameras: Sequence[str] = () if card is None else card.cameras
        self._rates: Mapping[str, float] = {} if card is None else card.camera_hz
        self._next_s: dict[str, float] = {}
        """Camera with a rate -> when its next view is due."""

    def due(self, time_s: float, asked: Collection[str]) -> set[str]:
        """Return the cameras that are due; call it for each observation. ``asked``: those that actions named since."""
        taking = set[str]()
        for name in self._cameras:
            due_s = self._next_s.get(name, 0.0) if name in self._rates else time_s
            if name in asked or time_s >= due_s - self._early_s:
                taking.add(name)
            rate = self._rates.get(name, 0.0)
            while rate and due_s - self._early_s <= time_s:
                due_s = (round(due_s * rate) + 1) / rate
            self._next_s[name] = due_s if rate else math.inf
        return taking


def check_message(
    sent: bytes, card: PolicyCard | None, *, joints: int, due: Collection[str] | None = None
) -> list[tuple[str, str]]:
    """Return pairs of a place and what is wrong there, for one message that asks the policy to act. ``due``: cameras
    that took a view for this observation (``Timetable``); by default all of the card."""
    message = unpack(sent)
    if not isinstance(message, dict) or set(message) != MESSAGE:
        keys = sorted(message) if isinstance(message, dict) else type(message).__name__
        return [("message", f"expected the keys {sorted(MESSAGE)}, got {keys}")]
    privileged = (
        "this key contains a word of privileged information (PRIVILEGED in audit/finding.py); no policy may receive it"
    )
    keys = _message_keys(message["observation"], "observation")
    found = [(place, privileged) for place in keys if any(word in place.rpartition(".")[2] for word in PRIVILEGED)]
    try:
        observation = codec.decode_observation(message["observation"])
    except ContractError as error:
        return [*found, ("observation", str(error))]
    if (got := len(observation.joint_position)) != joints:
        found.append(("observation.joint_position", f"expected {joints} numbers, got {got}"))
    if card is None:
        return [*found, ("card", "an observation was sent to a policy that showed no card")]
    if (observation.velocity_tcp_in_base is not None) != card.tool_velocity:
        what = "was not sent, although the card requests it" if card.tool_velocity else "was sent without a request"
        found.append(("observation.velocity_tcp_in_base", what))
    requested, shown = sorted(set(card.cameras if due is None else due)), sorted(observation.cameras)
    if requested != shown:
        wants = "the card requests" if due is None or set(due) == set(card.cameras) else "due by card and actions are"
        holds = f"{wants} {requested or 'none'}, but the message holds {shown}"
        found.append(("observation.cameras", holds))
    wanted = ALWAYS.union(*(FIELDS_OF[m] for m in card.modalities))
    for name, view in observation.cameras.items():
        sent_fields = {field for field, value in vars(view).items() if value is not None} - {codec.VIEW_TIME}
        place = "observation.cameras"
        more, less = "was sent, although the card does not request it", "was not sent, although the card requests it"
        found += [(f"{place}.{name}.{field}", more) for field in sorted(sent_fields - wanted)]
        found += [(f"{place}.{name}.{field}", less) for field in sorted(wanted - sent_fields)]
    return found


def _message_keys(value: Any, place: str) -> list[str]:
    if not isinstance(value, dict):
        return []
    return [p for key, inner in value.items() for p in (f"{place}.{key}", *_message_keys(inner, f"{place}.{key}"))]
