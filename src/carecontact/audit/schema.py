"""Part (e) tests whether a policy gets what its card names, in the contract's schema, and nothing more."""

from __future__ import annotations

import re
from typing import Any

from carecontact.audit.dialects import check_conversation
from carecontact.audit.finding import Finding, Part
from carecontact.audit.watched import Watched
from carecontact.audit.words import PRIVILEGED
from carecontact.contract.policy import PolicyCard
from carecontact.errors import ContractError
from carecontact.hosting.dialects.again import dialect_of
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.packing import unpack
from carecontact.recording.reason import reason

NAME, TITLE = "schema", "messages of real trials of each policy"
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
    findings: list[Finding] = []
    messages = 0
    for trial in trials:
        if trial.error:
            told = f"the trial failed, so the audit did not see all of its messages: {reason(trial.error)}"
            findings += [Finding(policy=trial.policy, place=place, told=told) for place in failed_at(trial.error)]
        card = trial.card
        if card is not None and dialect_of(card.arguments):
            sent = [message for message in trial.sent if message]
            messages += len(sent)
            found = check_conversation(sent, card, instruction=trial.instruction)
            findings += [Finding(policy=trial.policy, place=place, told=told) for place, told in found]
            continue
        messages += len(trial.looks)
        for look in trial.looks:
            found = check_message(look.sent, card, joints=trial.joints)
            findings += [Finding(policy=trial.policy, place=place, told=told) for place, told in found]
    return Part(
        name=NAME, title=TITLE,
        counts={"trials": len(trials), "messages": messages},
        findings=tuple(dict.fromkeys(findings)),
    )  # fmt: skip


def failed_at(error: str) -> list[str]:
    """Return the keys that the policy's end refused, if its trial failed for that reason; otherwise ``trial``."""
    refused = _REFUSED.search(reason(error))
    return ["trial"] if refused is None else [f"{refused[1]}.{key}" for key in refused[2].split(", ")]


def check_message(sent: bytes, card: PolicyCard | None, *, joints: int) -> list[tuple[str, str]]:
    """Return pairs of a place and what is wrong there, for one message that asks the policy to act.

    ``joints``: number of the robot's joints; the wire takes any number of angles.
    """
    message = unpack(sent)
    if not isinstance(message, dict) or set(message) != MESSAGE:
        keys = sorted(message) if isinstance(message, dict) else type(message).__name__
        return [("message", f"expected the keys {sorted(MESSAGE)}, got {keys}")]
    told = "this key contains a word of privileged information (PRIVILEGED in audit/words.py); no policy may receive it"
    found = [(place, told) for place in _keys(message["observation"], "observation")
             if any(word in place.rpartition(".")[2] for word in PRIVILEGED)]  # fmt: skip
    try:
        observation = codec.decode_observation(message["observation"])
    except ContractError as error:
        return [*found, ("observation", str(error))]
    if (got := len(observation.joint_position)) != joints:
        found.append(("observation.joint_position", f"expected {joints} numbers, got {got}"))
    if card is None:
        return [*found, ("card", "an observation was sent to a policy that showed no card")]
    cameras = set(card.cameras)
    if set(observation.cameras) != cameras:
        told = f"the card requests {sorted(cameras) or 'none'}, but the message holds {sorted(observation.cameras)}"
        found.append(("observation.cameras", told))
    wanted = ALWAYS.union(*(FIELDS_OF[m] for m in card.modalities))
    for name, view in observation.cameras.items():
        sent_fields = {field for field, value in vars(view).items() if value is not None}
        found += [
            (f"observation.cameras.{name}.{f}", "was sent, although the card does not request it")
            for f in sorted(sent_fields - wanted)
        ]
        found += [
            (f"observation.cameras.{name}.{f}", "was not sent, although the card requests it")
            for f in sorted(wanted - sent_fields)
        ]
    return found


def _keys(value: Any, place: str) -> list[str]:
    if not isinstance(value, dict):
        return []
    return [p for key, inner in value.items() for p in (f"{place}.{key}", *_keys(inner, f"{place}.{key}"))]
