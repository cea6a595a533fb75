"""Hints for a policy whose card or answer is of a wrong type: what it may have meant, and what to write instead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from carecontact.contract.action.hints import pose_shape_hint

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
