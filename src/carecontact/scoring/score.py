"""Scores one recording: validity, contact, verdict, metrics and attribution."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from carecontact.errors import ConfigError, RecordingError
from carecontact.interface.geometry import Triangles, matrix_from_quat
from carecontact.interface.robot import robot_of
from carecontact.recording import Header, canonical_hash
from carecontact.recording.notes import language_use
from carecontact.recording.provenance import provenance_of
from carecontact.recording.schema import Recording
from carecontact.scoring.attribution import attribute
from carecontact.scoring.contact import Contact, any_column, find_contact
from carecontact.scoring.gate_sweep import sweep_gates
from carecontact.scoring.metrics.force import beyond_calibrated, deepest_indentation, peak_of_segments, total_impulse
from carecontact.scoring.metrics.metric import METRICS, Metric, checked_metrics
from carecontact.scoring.metrics.success import judge, measure
from carecontact.scoring.result import DRAWN, TrialScore
from carecontact.scoring.validity import check_streams
from carecontact.scoring.verdict import reach_verdict

# Whether the skin lay beyond the middle of the robot's tool when the force was largest.
#
# The compiled tissue drops skin that has sunk into a tool beyond the tool's middle. Such a tool is held by nothing
# until it meets bone, and what is measured from then on says nothing of a person. The recording keeps the dented skin
# of that one moment, so that a tool that went through and came back before is not found.

BEHIND_M = 0.1
"""How far behind the tool's middle skin is looked for."""
NEEDED = ("report/skin_in_world", "report/skin_faces", "report/peak_time_s")


def passed_the_middle(recording: Recording) -> float | None:
    """Return ``skin_in_tool`` of a recording where it is more than 1; None for any other."""
    found = skin_in_tool(recording)
    return found if found is not None and found > 1 else None


def skin_in_tool(recording: Recording) -> float | None:
    """Return how far the skin lies inside the tool at the largest force, over half of the tool's thickness. Above 1, it
    lies beyond the tool's middle; below 0, outside.

    None if the recording does not have the dented skin, is of a robot that this release does not have, or if no skin of
    the region lies on the tool's axis.
    """
    robot = robot_of(recording.header.embodiment)
    if robot is None or any(name not in recording for name in NEEDED) or not len(recording["scorer/time_s"]):
        return None
    tip, at = robot.tip, int(np.searchsorted(recording["scorer/time_s"], float(recording["report/peak_time_s"][0])))
    pose = recording["scorer/pose_tcp_in_world"][min(at, len(recording["scorer/time_s"]) - 1)].astype(np.float64)
    out = matrix_from_quat(pose[3:])[:, 2]
    middle = pose[:3] - tip.half_m[2] * out
    skin = recording["report/skin_in_world"].astype(np.float64)
    surface = Triangles(skin[recording["report/skin_faces"]])
    ahead = float(surface.distances(middle - BEHIND_M * out, out[None])[0]) - BEHIND_M
    return None if np.isinf(ahead) else 1.0 - ahead / tip.half_m[2]


# Recording in, score out: the one function that every number of a result comes from.


def score_recording(recording: Recording) -> TrialScore:
    """Score one trial by the settings of the protocol in its header; no simulator, no clock, no other file.

    Raises RecordingError naming the array if a scorer stream holds what it cannot hold, or if its samples are not one
    physics step apart: a broken stream never becomes a number. Raises ConfigError naming a metric or an action, its
    package and the trial where that is at fault.
    """
    check_streams(recording)
    contact = find_contact(recording)
    measured, additional = measure_all(contact)
    score = TrialScore(
        **_trial(contact, canonical_hash(recording)),
        **measured,
        **_contact(contact),
        **_outcome(contact),
        metric_versions=_versions(contact),
        additional=additional,
    )
    check_finite(score.trial_id, dict(score) | score.additional)
    return score


def measure_all(contact: Contact) -> tuple[dict[str, Any], dict[str, float | None]]:
    """Return every registered metric of one trial: fields of ``TrialScore`` with their values, then id -> value of the
    others.

    Raises ConfigError as ``checked_metrics`` and ``Metric.compute`` do, and if two metrics fill the same field.
    """
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
    """Raises RecordingError, which begins with ``place``, for an infinite value or NaN; ConfigError, which names the
    metric, for one of a metric that another package supplies."""
    for name, value in values.items():
        if isinstance(value, float) and not isfinite(value):
            if METRICS.package(name):
                raise ConfigError(f"{METRICS.title(name)} returned {value} in trial {place}; return None for NA")
            raise RecordingError(f"{place}: {name} comes out as {value}; its arrays are out of all range")


def _trial(contact: Contact, sha256: str) -> dict[str, Any]:
    """Return which trial it is, where it comes from and how it ended."""
    header, protocol, spoken = contact.recording.header, contact.protocol, language_use(contact.recording)
    return {
        "trial_id": header.spec.trial_id,
        "task_id": contact.task.id,
        "action": contact.task.action,
        "region": contact.task.region,
        "seed": header.spec.seed,
        "policy": header.spec.policy,
        "policy_arguments": header.spec.policy_arguments,
        "privileged": header.privileged,
        "policy_name": _card_name(header),
        "language_backend": str(header.card.get("language_backend", "none")) if header.card else "none",
        "language_sha256": spoken.sha256,
        "language_endpoint": spoken.endpoint,
        "language_served": spoken.served,
        "language_sent": spoken.sent,
        "protocol_id": protocol.name,
        "protocol_sha256": header.spec.protocol.sha256,
        "overrides": protocol.overrides,
        "recording_sha256": sha256,
        "world": _world(contact),
        "provenance": provenance_of(contact.recording),
        "ended": header.ended,
        "duration_s": float(contact.time_s[-1]) if len(contact.time_s) else 0.0,
        "failure_message": header.failure.message if header.failure else None,
        "clipped_actions": _clipped_actions(contact),
    }


def _card_name(header: Header) -> str | None:
    """Return the name on the card of a policy behind an address."""
    return str(header.card["name"]) if header.card and "://" in header.spec.policy else None


def _clipped_actions(contact: Contact) -> int:
    clipped = contact.recording.arrays.get("actions/clipped")
    return 0 if clipped is None else int(clipped.sum())


def _world(contact: Contact) -> dict[str, str]:
    """Return what was put into the simulation. The controller is a part of it, since it decides how stiff the robot is.
    The action space is not: it is the method's language, and methods that speak different ones are compared."""
    header = contact.recording.header
    world = header.identity | {n: header.sha256[n] for n in ("body", "robot") if n in header.sha256}
    if header.spec.protocol.variation.draws_models and "body" in world:
        world[f"{DRAWN}body"] = world.pop("body")
    if "mujoco" in header.versions:
        world["mujoco"] = header.versions["mujoco"]
    if header.control is not None:
        world["control"] = header.control
    if header.spec.salt_sha256:
        world["salt"] = header.spec.salt_sha256
    if rejected := header.spec.protocol.person.rejected_tissue:
        world["rejected_tissue"] = rejected
    return world


def _contact(contact: Contact) -> dict[str, Any]:
    """Return what was touched, for how long and how hard, beside the metrics."""
    protocol, touched = contact.protocol, [contact.segments[i] for i in contact.touched]
    return {
        "valid_contact": contact.valid,
        "reported_segment": contact.segments[contact.reported] if contact.reported is not None else None,
        "region_share": contact.region_share,
        "contact_s": int(any_column(contact.on, contact.touched).sum()) * contact.dt_s,
        "indentation_m": deepest_indentation(contact),
        "impulse_ns": total_impulse(contact),
        "extrapolated_share": beyond_calibrated(contact),
        "skin_in_tool": passed_the_middle(contact.recording),
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


def _versions(contact: Contact) -> dict[str, str]:
    """Return the definitions behind the fields of a score."""
    with_field: list[Metric] = [row for row in METRICS.values() if row.field is not None]
    return {
        **{row.name: row.id for row in with_field},
        "contact": contact.protocol.contact.version,
        "gates": contact.protocol.gates.set,
        "limits": contact.protocol.limits.pack,
    }
