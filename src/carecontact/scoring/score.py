"""Recording in, score out: the one function that every number of a result comes from."""

from __future__ import annotations

from math import isfinite

from carecontact.errors import RecordingError
from carecontact.recording import Recording, canonical_hash, check_recording
from carecontact.recording.notes import language_use
from carecontact.scoring.attribution.attribute import attribute
from carecontact.scoring.contact import Contact, any_column, find_contact
from carecontact.scoring.gate_sweep import sweep_gates
from carecontact.scoring.metrics import exposure, force_predicted, force_rate, shear_work, utilisation
from carecontact.scoring.metrics.c1_peak_force import peak_force, peak_of_segments
from carecontact.scoring.metrics.c2_joint_margin import joint_margin
from carecontact.scoring.metrics.c3_success import judge, measure
from carecontact.scoring.metrics.c4_motion_activity import motion_activity
from carecontact.scoring.metrics.c5_force_stability import force_stability
from carecontact.scoring.metrics.impulse import total_impulse
from carecontact.scoring.metrics.indentation import beyond_calibrated, deepest_indentation
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.result import TrialScore
from carecontact.scoring.validity.streams import check_streams
from carecontact.scoring.verdict import reach_verdict

BUILT_IN = ("C1@1", "C2@1", "C3@1", "C4@1", "C5@1")
ALSO_KEPT = (exposure, force_predicted, force_rate, shear_work, utilisation)
"""Files whose metrics are rows of METRICS and nothing else."""


def score_recording(recording: Recording, *, sha256: str | None = None) -> TrialScore:
    """Score one trial by the settings of the protocol in its header; no simulator, no clock, no other file.

    Raises RecordingError naming the array if a required one is missing or malformed, if a scorer stream holds what it
    cannot hold, or if its samples are not one physics step apart: a broken stream never becomes a number.

    Args:
        sha256: canonical hash that the recording was verified by; default: computed.
    """
    header = recording.header
    check_recording(recording, header.spec.trial_id)
    check_streams(recording)
    contact = find_contact(recording)
    measures = measure(contact)
    gate = judge(contact, measures)
    verdict = reach_verdict(contact, gate)
    attribution, evidence = attribute(contact, gate, verdict.failure_mode) if verdict.failure_mode else (None, None)
    c1, c2, best = peak_force(contact), joint_margin(contact), gate.best
    protocol, spoken = contact.protocol, language_use(recording)
    score = TrialScore(
        trial_id=header.spec.trial_id,
        task_id=contact.task.id,
        action=contact.task.action,
        region=contact.task.region,
        seed=header.spec.seed,
        policy=header.spec.policy,
        language_backend=str(header.card.get("language_backend", "none")) if header.card else "none",
        language_sha256=spoken.sha256,
        language_endpoint=spoken.endpoint,
        language_served=spoken.served,
        language_sent=spoken.sent,
        protocol_id=protocol.id,
        protocol_sha256=protocol.sha256,
        overrides=protocol.overrides,
        recording_sha256=sha256 or canonical_hash(recording),
        world=_world(contact),
        ended=header.ended,
        duration_s=float(contact.time_s[-1]) if len(contact.time_s) else 0.0,
        failure_message=header.failure.message if header.failure else None,
        anatomy=verdict.anatomy,
        valid_contact=contact.valid,
        reported_segment=contact.segments[contact.reported] if contact.reported is not None else None,
        c1_peak_force_n=c1.peak if c1 else None,
        c1_peak_filtered_n=c1.filtered if c1 else None,
        c1_peak_contact_sum_n=c1.contact_sum if c1 else None,
        c1_peak_any_segment_n=c1.any_segment if c1 else None,
        c2_joint_margin_rad=c2.margin if c2 else None,
        c2_joint=c2.joint if c2 else None,
        c2_time_s=c2.time_s if c2 else None,
        c2_settled_margin_rad=c2.settled if c2 else None,
        c2_change_rad=c2.change if c2 else None,
        c3_success=verdict.success,
        region_correct=verdict.region_correct,
        safety_gated=verdict.safety_gated,
        c4_motion_activity=motion_activity(contact),
        c5_force_sd_n=force_stability(contact),
        region_share=contact.region_share,
        contact_s=int(any_column(contact.on, contact.touched).sum()) * contact.dt_s,
        longest_on_s=gate.longest_on_s,
        on_share=best.on_share if best else None,
        stroke_m=best.stroke_m if best else 0.0,
        extent_m=best.extent_m if best else 0.0,
        reversals=best.reversals if best else 0,
        wrist_displacement_m=gate.wrist_m,
        wrist_displacement_any_m=gate.wrist_any_m,
        indentation_m=deepest_indentation(contact),
        impulse_ns=total_impulse(contact),
        extrapolated_share=beyond_calibrated(contact),
        peak_force_n=peak_of_segments(contact),
        f_pain_n={s: protocol.f_pain(s) for s in (contact.segments[i] for i in contact.touched)},
        over_limit=verdict.over_limit,
        fallback_limits=[s for s in (contact.segments[i] for i in contact.touched) if not protocol.has_own_limit(s)],
        failure_mode=verdict.failure_mode,
        attribution=attribution,
        evidence=evidence,
        metric_versions={
            **{id_.partition("@")[0]: id_ for id_ in BUILT_IN},
            "contact": protocol.contact.version,
            "gates": protocol.gates.version,
            "limits": protocol.limits.pack,
        },
        gate_sweep=sweep_gates(contact, measures, verdict),
        additional={id_: METRICS[id_].compute(contact) for id_ in METRICS if id_ not in BUILT_IN},
    )
    for name, value in (*score, *score.additional.items()):
        if isinstance(value, float) and not isfinite(value):
            raise RecordingError(
                f"{header.spec.trial_id}: {name} comes out as {value}; its arrays are out of all range"
            )
    return score


def _world(contact: Contact) -> dict[str, str]:
    header = contact.recording.header
    world = {name: header.sha256[name] for name in ("body", "robot", "model") if name in header.sha256}
    if "mujoco" in header.versions:
        world["mujoco"] = header.versions["mujoco"]
    return world
