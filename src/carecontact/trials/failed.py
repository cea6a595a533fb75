"""The recording of a trial of which nothing but its failure is left."""

from __future__ import annotations

import math
import re

from carecontact.contract.trial import TrialSpec
from carecontact.recording.schema import REGIONS, SEGMENTS, EndReason, Failure, Header, Recording, empty_arrays
from carecontact.trials.versions import package_versions

EVIDENCE_CHARACTERS = 4000
"""Length of the tail of a traceback or of stderr kept in a recording; the whole is in the trial's log."""

_TRACEBACK = "Traceback (most recent call last):"
_PRINTED = "\nit printed last:\n"
_RAISED = re.compile(r"^[A-Za-z_][\w.]*(Error|Exception|Exit|Interrupt|Warning)\b")


def harness_error_recording(spec: TrialSpec, *, kind: str, message: str) -> Recording:
    """A zero-length recording with ``ended="harness_error"`` and the evidence in its failure; judges nobody."""
    return _without_data(spec, ended="harness_error", kind=kind, message=message)


def killed_by_policy_recording(spec: TrialSpec, *, message: str) -> Recording:
    """A zero-length recording with ``ended="process_failure"``: a trial whose process dies whenever its policy runs."""
    return _without_data(spec, ended="process_failure", kind="killed", message=message)


def _without_data(spec: TrialSpec, *, ended: EndReason, kind: str, message: str) -> Recording:
    half_yaw = math.radians(spec.protocol.scene.robot_yaw_deg) / 2
    header = Header(
        spec=spec,
        ended=ended,
        failure=Failure(kind=kind, message=message),
        card=None,
        embodiment="none",
        comfort_arm_deg=None,
        segments=list(SEGMENTS),
        regions=list(REGIONS),
        human_joints=[],
        pose_base_in_world=[*spec.protocol.scene.robot_base_m, math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)],
        versions=package_versions(spec.protocol.vision.segmenter),
        sha256={},
        solver_warnings=[],
    )
    return Recording(header=header, arrays=empty_arrays(0))


def reason(message: str) -> str:
    """The line of a failure that says why: the exception under its last traceback, else the first line.

    What a policy printed is no reason, whatever it looks like.
    """
    said = message.partition(_PRINTED)[0]
    _, trace, after = said.rpartition(_TRACEBACK)
    lines = after.splitlines() if trace else said.splitlines()[1:]
    # Everything in a traceback is indented but the exception. One that was cut at its start is known by the name alone.
    raised = [line for line in lines if line[:1].strip() and (trace or _RAISED.match(line))]
    if raised:
        return raised[0] if trace else raised[-1]
    return said.partition("\n")[0]


def tail(text: str, *, characters: int = EVIDENCE_CHARACTERS) -> str:
    """The end of a text, cut at a line."""
    if len(text) <= characters:
        return text.strip()
    cut = text[-characters:]
    return "[...] " + cut[cut.find("\n") + 1 :].strip()
