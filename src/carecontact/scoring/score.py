"""Scores one recording: validity, contact, verdict, metrics and attribution."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from carecontact.errors import ConfigError, RecordingError
from carecontact.interface.geometry import Triangles, matrix_from_quat
from carecontact.interface.robot import robot_of
from carecontact.recording import canonical_hash
from carecontact.recording.notes import language_use
from carecontact.recording.provenance import provenance_of
from carecontact.recording.schema import Recording
from carecontact.scoring.attribution import attribute
from carecontact.scoring.contact import Contact, any_column, find_contact
from carecontact.scoring.gate_sweep import sweep_gates
from carecontact.scoring.metrics.force import beyond_calibrated, deepest_indentation, peak_of_segments
from carecontact.scoring.metrics.metric import METRICS, checked_metrics
from carecontact.scoring.metrics.success import judge, measure
from carecontact.scoring.result import DRAWN, TrialScore
from carecontact.scoring.validity import check_streams
from carecontact.scoring.verdict import reach_verdict

BEHIND_M = 0.1
"""How far behind the tool's middle skin is looked for."""
NEEDED = ("report/skin_in_world", "report/skin_faces", "report/peak_time_s")


def skin_in_tool(recording: Recording) -> float | None:
    """Return how far the skin lies inside the tool at the largest force, over half of the tool's thickness. Above 1, it
    lies beyond the tool's middle; below 0, outside.

    The compiled tissue drops skin that has sunk into a tool beyond the tool's middle. Such a tool is held by nothing
    until it meets bone, and what is measured from then on says nothing of a person. The recording keeps the dented skin
    of that one moment, so that a tool that went through and came back before is not found.

    None if the recording does not have the dented skin, is of a robot that this release does not have, or if no skin of
    the region lies on the tool's axis.
    """
    robot, time = robot_of(recording.header.embodiment), recording["scorer/time_s"]
    if robot is None or any(name not in recording for name in NEEDED) or not len(time):
        return None
    thickness_m, at = robot.tip.half_m[2], int(np.searchsorted(time, float(recording["report/peak_time_s"][0])))
    pose = recording["scorer/pose_tcp_in_world"][min(at, len(time) - 1)].astype(np.float64)
    out = matrix_from_quat(pose[3:])[:, 2]
    skin = recording["report/skin_in_world"].astype(np.float64)
    surface = Triangles(skin[recording["report/skin_faces"]])
    behind = pose[:3] - thickness_m * out - BEHIND_M * out
    ahead = float(surface.distances(behind, out[None])[0]) - BEHIND_M
    return None if np.isinf(ahead) else 1.0 - ahead / thickness_m


def score_recording(recording: Recording) -> TrialScore:
    """Score one trial by the settings of the protocol in its header; no simulator, no clock, no other file.

    Raises RecordingError naming the array if a scorer stream holds what it cannot hold: a broken stream never becomes a
    number. Raises ConfigError naming a metric or an action, its package and the trial where that is at fault.
    """
    check_streams(recording)
    contact = find_contact(recording)
    measured, additional = measure_all(contact)
    score = TrialScore(
        **_trial(contact, canonical_hash(recording)),
        **measured,
        **_contact(contact),
        **_outcome(contact),
        # The definitions behind the fields.
        metric_versions={
            **{row.name: row.id for row in METRICS.values() if row.field is not None},
            "contact": contact.protocol.contact.version,
            "gates": contact.protocol.gates.set,
            "limits": contact.protocol.limits.pack,
        },
        additional=additional,
    )
    check_finite(score.trial_id, dict(score) | score.additional)
    return score


def measure_all(contact: Contact) -> tuple[dict[str, Any], dict[str, float | None]]:
    """Return every metric of a trial: fields of ``TrialScore`` with their values, then id -> value of the others."""
    filled: dict[str, Any] = {}
    additional: dict[str, float | None] = {}
    for row in checked_metrics():
        if row.field is None:
            additional[row.id] = row.compute(contact)
            continue
        found = row.fill(contact)
        if taken := filled.keys() & found.keys():
            raise ConfigError(f"metric {row.id}: another metric fills the field {min(taken)!r} already")
        filled |= found
    return filled, additional


def check_finite(place: str, values: dict[str, Any]) -> None:
    """Raises RecordingError for a value that is not finite, or ConfigError where another package's metric gave it."""
    for name, value in values.items():
        if isinstance(value, float) and not isfinite(value):
            if METRICS.package(name):
                raise ConfigError(f"{METRICS.title(name)} returned {value} in trial {place}; return None for NA")
            raise RecordingError(f"{place}: {name} comes out as {value}; its arrays are out of all range")


def _trial(contact: Contact, sha256: str) -> dict[str, Any]:
    """Return which trial it is, where it comes from and how it ended."""
    header, protocol, spoken = contact.recording.header, contact.protocol, language_use(contact.recording)
    spec, card, clipped = header.spec, header.card or {}, contact.recording.arrays.get("actions/clipped")
    return {
        "trial_id": spec.trial_id,
        "task_id": contact.task.id,
        "action": contact.task.action,
        "region": contact.task.region,
        "seed": spec.seed,
        "policy": spec.policy,
        "policy_arguments": spec.policy_arguments,
        "privileged": header.privileged,
        "policy_name": str(card["name"]) if card and "://" in spec.policy else None,
        "language_backend": str(card.get("language_backend", "none")),
        "language_sha256": spoken.sha256,
        "language_endpoint": spoken.endpoint,
        "language_served": spoken.served,
        "language_sent": spoken.sent,
        "protocol_id": protocol.name,
        "protocol_sha256": spec.protocol.sha256,
        "overrides": protocol.overrides,
        "recording_sha256": sha256,
        "world": _world(contact),
        "provenance": provenance_of(contact.recording),
        "ended": header.ended,
        "duration_s": float(contact.time_s[-1]) if len(contact.time_s) else 0.0,
        "failure_message": header.failure.message if header.failure else None,
        "clipped_actions": 0 if clipped is None else int(clipped.sum()),
    }


def _world(contact: Contact) -> dict[str, str]:
    """What was put into the simulation. The controller is part of it; the action space is the method's language."""
    header, protocol = contact.recording.header, contact.recording.header.spec.protocol
    world = header.identity | {n: header.sha256[n] for n in ("body", "robot") if n in header.sha256}
    if protocol.variation.draws_models and "body" in world:
        world[f"{DRAWN}body"] = world.pop("body")
    added = {
        "mujoco": header.versions.get("mujoco"),
        "control": header.control,
        "salt": header.spec.salt_sha256 or None,
        "rejected_tissue": protocol.person.rejected_tissue or None,
    }
    return world | {name: value for name, value in added.items() if value is not None}


def _contact(contact: Contact) -> dict[str, Any]:
    """Return what was touched, for how long and how hard, beside the metrics."""
    protocol, touched = contact.protocol, [contact.segments[i] for i in contact.touched]
    skin = skin_in_tool(contact.recording)
    return {
        "valid_contact": contact.valid,
        "reported_segment": contact.segments[contact.reported] if contact.reported is not None else None,
        "region_share": contact.region_share,
        "contact_s": int(any_column(contact.on, contact.touched).sum()) * contact.dt_s,
        "indentation_m": deepest_indentation(contact),
        "impulse_ns": float(contact.impulse_ns.sum()),
        "extrapolated_share": beyond_calibrated(contact),
        "skin_in_tool": skin if skin is not None and skin > 1 else None,
        "peak_force_n": peak_of_segments(contact),
        "f_pain_n": {segment: protocol.f_pain(segment) for segment in touched},
        "fallback_limits": [segment for segment in touched if not protocol.has_own_limit(segment)],
    }


def _outcome(contact: Contact) -> dict[str, Any]:
    """Return the verdict, why a trial failed, and the verdict under other gates."""
    measures = measure(contact)
    gate = judge(contact, measures)
    verdict = reach_verdict(contact, gate)
    attribution, evidence = attribute(contact, gate, verdict.failure_mode) if verdict.failure_mode else (None, None)
    return {
        "anatomy": verdict.anatomy,
        "region_correct": verdict.region_correct,
        "safety_gated": verdict.safety_gated,
        "over_limit": verdict.over_limit,
        "joints_beyond": verdict.joints_beyond,
        "joints_consumed": verdict.joints_consumed,
        "failure_mode": verdict.failure_mode,
        "attribution": attribution,
        "evidence": evidence,
        "gate_sweep": sweep_gates(contact, measures, verdict),
    }
