"""Makes the recording of a trial that left nothing but its failure."""

from __future__ import annotations

import math

from carecontact.contract.trial import TrialSpec
from carecontact.recording.schema import POLICY_KILLED, SEGMENTS, EndReason, Failure, Header, Recording, empty_arrays
from carecontact.recording.versions import DECLARED, trial_versions

EVIDENCE_CHARACTERS = 4000
"""Length of the tail of a traceback or of stderr kept in a recording; the whole is in the trial's log."""


def harness_error_recording(spec: TrialSpec, *, kind: str, message: str) -> Recording:
    """Return a zero-length recording with ``ended="harness_error"`` and the evidence in its failure. It counts neither
    for nor against the policy."""
    return _without_data(spec, ended="harness_error", kind=kind, message=message)


def killed_by_policy_recording(spec: TrialSpec, *, message: str) -> Recording:
    """Return a zero-length recording with ``ended="process_failure"``: a trial whose process dies whenever its policy
    runs."""
    return _without_data(spec, ended="process_failure", kind=POLICY_KILLED, message=message)


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
        regions=list(spec.protocol.regions),
        human_joints=[],
        pose_base_in_world=[*spec.protocol.scene.robot_base_m, math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)],
        identity=DECLARED,
        versions=trial_versions(spec.protocol),
        sha256={},
        solver_warnings=[],
    )
    return Recording(header=header, arrays=empty_arrays(0, regions=len(header.regions)))


def tail(text: str, *, characters: int = EVIDENCE_CHARACTERS) -> str:
    """Return the end of a text, cut at a line."""
    if len(text) <= characters:
        return text.strip()
    cut = text[-characters:]
    return "[...] " + cut[cut.find("\n") + 1 :].strip()
