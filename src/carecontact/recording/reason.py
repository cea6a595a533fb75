"""Finds, in the message of a failure, the one line that gives the reason; the message may be a whole traceback."""

from __future__ import annotations

import re

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
    """Return what ``reason`` does, but keep what is not a traceback as it is: nobody may write the reason of a
    failure."""
    if failure.kind in _PLAIN:
        return " ".join(failure.message.partition(PRINTED)[0].split())
    return reason(failure.message)


def reason(message: str) -> str:
    """Return the line of a failure that says why: the exception under its last traceback, else the first line.

    What a policy printed is not a reason, whatever it looks like.
    """
    said = message.partition(PRINTED)[0]
    _, trace, after = said.rpartition(TRACEBACK)
    lines = after.splitlines() if trace else said.splitlines()[1:]
    # Everything in a traceback is indented but the exception. One that was cut at its start is known by the name alone.
    raised = [line for line in lines if line[:1].strip() and (trace or _RAISED.match(line))]
    if raised:
        return raised[0] if trace else raised[-1]
    return said.partition("\n")[0]
