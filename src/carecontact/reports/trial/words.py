"""What happened in one trial, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from carecontact.errors import counted
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import Header, Recording
from carecontact.regions import REGIONS
from carecontact.reports.cause_words import cause_text
from carecontact.reports.evidence_words import evidence_text, spaced
from carecontact.reports.failures import MODE_MEANING
from carecontact.reports.joint_words import beyond_text, consumed_text
from carecontact.reports.moment.moment import Moment, region_column, region_poses
from carecontact.reports.moment.place import place_notes, place_text
from carecontact.reports.page.paths import shortened
from carecontact.reports.page.trial_words import progress
from carecontact.reports.text import percent, task_name
from carecontact.scoring.contact import Contact, any_column, runs
from carecontact.scoring.faint import faint_press
from carecontact.scoring.gate import GatePart
from carecontact.scoring.region import distance_to_surface, points_in_region
from carecontact.scoring.result import TrialScore


def outcome(score: TrialScore, contact: Contact, gates: Sequence[GatePart]) -> str:
    """Return the heading of the page; ``gates``: every gate of the trial, as ``gate_parts`` returns them."""
    header, name = contact.recording.header, f"{score.task_id} {task_name(score)}, seed {score.seed},"
    if score.is_crash:
        when = f"after {score.duration_s:.2f} s" if score.duration_s else "before the first physics step"
        return f"{name} failed: the policy crashed {when}{_why(header)}."
    if score.ended == "harness_error":
        return f"{name} counts for nothing: the harness failed, and not the policy."
    if score.safety_gated:
        return f"{name} passed, on the {_segment(score)} and below the safety gate."
    if score.region_correct:
        joint = score.joints_beyond and not score.over_limit
        what = "moved a joint too far beyond its range" if joint else "exceeded the safety gate"
        return f"{name} succeeded on the {_segment(score)}, but {what}."
    meaning = mode_text(score, contact, gates)
    why = f": {meaning}" if meaning else ""
    hard = "; a force exceeded the safety gate" if score.over_limit else ""
    did = f"succeeded, but not on the {_segment(score)} alone" if score.c3_success else "failed"
    return f"{name} {did}{why}{hard}."


def _segment(score: TrialScore) -> str:
    """Return the segment of the named region, which decides whether a contact is on the region."""
    return REGIONS[score.region].segment.replace("_", " ")


def mode_text(score: TrialScore, contact: Contact, gates: Sequence[GatePart]) -> str:
    """Return the failure mode in words; of a mode that has several forms, the one that this trial had. Empty without
    one."""
    if score.failure_mode == "safety_truncation":
        return cause_text(score)
    if score.failure_mode == "no_target_contact" and not contact.force_norm.any():
        return "the robot never touched the person"
    held = {"insufficient_progress": _held(contact), "outside_band": "done, but too hard, too lightly or too far"}
    missed = [part for part in gates if not part.met]
    if score.failure_mode not in held or not missed:
        return MODE_MEANING.get(score.failure_mode or "", "")
    first, which = missed[0], "namely" if len(missed) == 1 else "first"
    told = f"“{first.name}”: {first.reached}, {first.needed} needed"
    return spaced(f"{held[score.failure_mode]}; the trial missed {counted(len(missed), 'gate')}, {which} {told}")


def _held(contact: Contact) -> str:
    """Return how often and how long the person was touched by contact that counts."""
    on = any_column(contact.on, contact.touched)
    times, held_s = len(runs(on)), int(on.sum()) * contact.dt_s
    told = "touched without interruption for" if times == 1 else f"touched {times} times, for"
    return f"{told} {held_s:.2f} s{'' if times == 1 else ' in all'}"


def facts(
    score: TrialScore, contact: Contact, moment: Moment | None, gates: Sequence[GatePart]
) -> list[tuple[str, str]]:
    """Return the facts about the trial as (question, answer), the most important first.

    ``gates`` as for ``outcome``.
    """
    recording = contact.recording
    rows = [("Progress", spaced(progress(score)))] if score.valid_contact else []
    if score.is_crash:
        rows.insert(0, ("Failure", "process failure. It counts as a failure of the policy; what the policy did to the "
                        "person before counts as well."))  # fmt: skip
        rows.insert(1, ("Evidence", evidence_text(score) or "none recorded"))
    elif score.failure_mode:
        mode, cause = score.failure_mode.replace("_", " "), score.attribution or "unattributed"
        rows.insert(0, ("Failure", f"{mode}. {_capital(mode_text(score, contact, gates))}."))
        rows.insert(1, ("Cause", f"{cause}. {_capital(cause_text(score))}."))
        rows.insert(2, ("Evidence", evidence_text(score) or "none recorded"))
    rows.append(("How hard", how_hard(score, contact, moment)))
    if beyond := beyond_text(score):
        rows.append(("Joints beyond their range", f"{_capital(beyond)}, farther than the protocol allows."))
    if consumed := consumed_text(score):
        rows.append(("Joints flagged", f"Share of its settled margin that a joint used up: {consumed}."))
    if moment is not None:
        where = [f"{_capital(place_text(recording, moment))}.", *place_notes(recording, moment)]
        rows.append(("Where", " ".join(where)))
        if moment.depth_m is not None and moment.deepest is not None:
            deepest_m, deepest_s = moment.deepest
            largest = f"at most {1000 * deepest_m:.1f} mm in the trial, at {deepest_s:.2f} s"
            rows.append(("How deep", f"{1000 * moment.depth_m:.1f} mm at that moment; {largest}."))
    rows.append(("End", _end(score, recording.header)))
    return rows


def how_hard(score: TrialScore, contact: Contact, moment: Moment | None) -> str:
    """Return a sentence that compares the scored peak force with the limits of the segment on which it occurred; where
    no contact counts, one that says what happened instead."""
    protocol = contact.protocol
    if score.c1_peak_force_n is None or score.reported_segment is None:
        faint = faint_press(contact)
        return f"The robot {faint}." if faint else f"The robot never touched the person{_closest(contact.recording)}."
    pain = protocol.f_pain(score.reported_segment)
    gate = protocol.limits.gamma * pain
    own = "" if score.reported_segment == REGIONS[score.region].segment else ", which is not the named region's segment"
    at = "" if moment is None else f" at {moment.time_s:.2f} s"
    peak, segment = score.c1_peak_force_n, score.reported_segment.replace("_", " ")
    return (
        f"Peak force {peak:.1f} N{at} on the {segment}{own}: {percent(peak / gate)} of its safety gate of {gate:g} N, "
        f"and {percent(peak / pain)} of its pain limit of {pain:g} N."
    )


def _closest(recording: Recording) -> str:
    """Return how near the tool's tip came to the region, and when; empty for a trial without a physics step."""
    tip = recording["scorer/pose_tcp_in_world"][:, :3].astype(np.float64)
    if not len(tip):
        return ""
    size = recording["scorer/region_size_m"][region_column(recording)]
    away = distance_to_surface(points_in_region(tip, region_poses(recording)), size)
    nearest = int(away.argmin())
    time_s = float(recording["scorer/time_s"][nearest])
    return f"; the tip of the tool came to {1000 * max(away[nearest], 0.0):.0f} mm from the region, at {time_s:.2f} s"


def _end(score: TrialScore, header: Header) -> str:
    told = {
        "done": "the policy said that it was done", "time_limit": "the time limit was reached",
        "safety_truncation": "the benchmark cut the trial", "process_failure": "the policy crashed",
        "harness_error": "the harness failed",
    }[header.ended]  # fmt: skip
    return f"After {score.duration_s:.2f} s, {told}{_why(header)}."


def _why(header: Header) -> str:
    """Return the reason of a failure after a colon; empty where none is recorded."""
    why = "" if header.failure is None else reason_of(header.failure).strip().rstrip(".:")
    return f": {shortened(why)}" if why else ""


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
