"""Why a trial ended before its time, in words, and what may help."""

from __future__ import annotations

import re

from carecontact.interface.policy import CAMERAS
from carecontact.recording.schema import EndReason, Failure

_PLAIN = ("action", "language", "program")
"""Kinds of failure whose messages are not tracebacks, but may hold words that a program or a language model chose."""
TRACEBACK = "Traceback (most recent call last):"
PRINTED = "\nit printed last:\n"
_RAISED = re.compile(r"^[A-Za-z_][\w.]*(Error|Exception|Exit|Interrupt|Warning)\b")

_VALUE = re.compile(r"\[[^\]]*\]|-?\d+(\.\d+(e[-+]?\d+)?|e[-+]?\d+)")
"""What may differ between two trials that failed alike: a list, or a number that is no integer, as codes and signals
are."""


_ENDED: dict[EndReason, str] = {
    "done": "done",
    "time_limit": "reached the time limit",
    "safety_truncation": "stopped by the benchmark",
    "process_failure": "crashed",
    "harness_error": "failed in the harness",
}


def ended_text(end: EndReason) -> str:
    """Return how a trial ended, as progress lines say it after the trial's name."""
    return _ENDED[end]


def alike(why: str) -> str:
    """Return a reason without its values, the same for trials that failed in the same way."""
    return _VALUE.sub("#", why)


def reason_of(failure: Failure) -> str:
    """Return ``reason`` of a traceback, and any other message whole: no program may choose the reason of a failure."""
    if failure.kind in _PLAIN:
        return " ".join(failure.message.partition(PRINTED)[0].split())
    return reason(failure.message)


def reason(message: str) -> str:
    """Return the line of a failure that says why: the exception under its last traceback, else the first line. What a
    policy printed is not a reason."""
    why = message.partition(PRINTED)[0]
    _, trace, after = why.rpartition(TRACEBACK)
    lines = after.splitlines() if trace else why.splitlines()[1:]
    # Everything in a traceback is indented but the exception. One that was cut at its start is known by the name alone.
    raised = [line for line in lines if line[:1].strip() and (trace or _RAISED.match(line))]
    if raised:
        return raised[0] if trace else raised[-1]
    return why.partition("\n")[0]


CAMERA = "The card's cameras say which cameras an observation has, if its modalities name anything."
REMEDIES = {
    "expected a position inside the workspace": "Check frame (base of the robot) and unit (metres). A card with "
    "out_of_bounds clip has such targets moved onto the border.",
    "expected finite numbers": "Look for a division by 0 or an unset value in the policy's output.",
    "expected a quaternion of norm 1": "Divide the quaternion by its norm; its order is w x y z. Angles have to be "
    "turned into a quaternion first.",
    "did not receive a valid HTTP response": "What listens there is no WebSocket server.",
    **{f"KeyError: '{camera}'": CAMERA for camera in CAMERAS},
    "'NoneType' object is not subscriptable": "A field of a camera's view is None unless the card's modalities name "
    "it; landmarks_in_base needs depth, too.",
    "'Observation' object is not subscriptable": "An observation has attributes, as in "
    "observation.cameras['overhead'].rgb.",
    "Action.__init__() got an unexpected keyword argument": "docs/your-policy.md lists the fields of an Action; "
    "a pose is pose_tcp_in_base.",
    "reset() takes 1 positional argument but 2 were given": "reset receives the instruction: write def reset(self, "
    "instruction).",
    "got coroutine": "The methods of a policy are plain functions: write def act, and not async def act.",
}
"""Part of a refusal -> what may help."""
LOOKS = "looks like"


def remedies(message: str) -> list[str]:
    """Return a sentence for each refusal of REMEDIES in a message that does not itself show a right answer."""
    if LOOKS in message:
        return []
    return [remedy for part, remedy in REMEDIES.items() if part in message]
