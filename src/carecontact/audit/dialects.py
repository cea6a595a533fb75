"""Audits the messages to a dialect's server: each may have the keys on the dialect's exact list and no other."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from carecontact.audit.words import PRIVILEGED
from carecontact.contract.policy import PolicyCard
from carecontact.errors import CarecontactError
from carecontact.hosting.dialects import chunks, vla_eval
from carecontact.hosting.dialects.again import dialect_of, unpacked
from carecontact.hosting.dialects.profiles import (
    CARTESIAN,
    ENDPOINT,
    GRIPPER,
    JOINTS,
    PROMPT,
    SESSION,
    profile_of,
)

Found = Iterator[tuple[str, str]]
"""Pairs of a place in a message and what is wrong there."""
RANDOM_ID = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}")
"""A UUID of version 4, which consists of random bits and can therefore reveal nothing."""
NUMBERS = {JOINTS: (chunks.JOINTS,), GRIPPER: (1,), CARTESIAN: (6,)}
"""Key of a message of openpi's family -> shape of its array of type ``<f8``."""


def check_conversation(messages: Sequence[bytes], card: PolicyCard, *, instruction: str) -> list[tuple[str, str]]:
    """Check all messages of one trial; return pairs of a place and what is wrong there.

    Args:
        messages: everything that was sent in one trial, in the order of sending.
        card: as the trial recorded it; its arguments name the dialect and what it sends.
        instruction: the trial's, the only text that may be sent.
    """
    dialect = dialect_of(card.arguments)
    found: list[tuple[str, str]] = []
    sessions: set[str] = set()
    for number, message in enumerate(messages, start=1):
        try:
            entries = unpacked(message, dialect)
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
    pictures = {"exterior": f"images.{vla_eval.EXTERIOR}", "wrist": f"images.{vla_eval.WRIST}"}
    left_out = {place for camera, place in pictures.items() if camera not in card.cameras}
    left_out |= {"states"} if card.arguments.get("state") != "yes" else set[str]()
    yield from _keys(_paths(payload), [key for key in vla_eval.KEYS[kind] if key not in left_out], kind)
    for place, value in _paths(payload).items():
        where = f"{kind}.{place}"
        if place in ("task_description", "task.name") and value != instruction:
            yield where, f"expected the instruction, got {value!r:.80}"
        elif place in vla_eval.HELLO and value != vla_eval.HELLO[place]:
            yield where, f"expected {vla_eval.HELLO[place]!r}, got {value!r:.80}"
        elif place == "states":
            yield from _array(value, "<f8", (chunks.WIDTH,), where)
        elif place in pictures.values():
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
