"""The page of one trial: every gate beside what it reached, what happened in words, and other trials of the same
person."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from carecontact.errors import counted
from carecontact.interface.regions import REGIONS
from carecontact.recording.file import replace_file
from carecontact.recording.notes import read_notes
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import EndReason, Header, Recording
from carecontact.report.baselines import role_in
from carecontact.report.comparison import trials_by_key
from carecontact.report.failures import MODE_MEANING, cause_text, evidence_text, progress, result_word, spaced
from carecontact.report.force_trace import force_trace
from carecontact.report.links import (
    link_page,
    links_of_page,
    page_path,
    replay_commands,
    shortened,
)
from carecontact.report.looks import action_rows, card_rows, looks_of, sent_views
from carecontact.report.miss import drawn_svg, is_hidden, miss_svg, nearest_miss
from carecontact.report.moment import Moment, peak_moment, peak_svg, place_notes, place_text
from carecontact.report.run_page import render
from carecontact.report.skin_view import noted_targets, paths, skin_views
from carecontact.report.svg import jpeg_data_uri
from carecontact.report.timeline import OUT_M, Panel, events, letter, panels_of, timeline_svg
from carecontact.report.words import beyond_text, consumed_text, percent, short_names, shown, shown_unit, task_name
from carecontact.runs.pooling import RunScores, rejected_text
from carecontact.scoring.behaviour import Gate, GatePart, ask, mm
from carecontact.scoring.contact import Contact, any_column, faint_press, find_contact, runs
from carecontact.scoring.foam import at_foam, place_share
from carecontact.scoring.limits import footnote
from carecontact.scoring.metrics.force import peak_of_segments
from carecontact.scoring.metrics.metric import METRICS, Metric, newest
from carecontact.scoring.metrics.success import judge
from carecontact.scoring.result import TrialScore

BROKEN: tuple[EndReason, ...] = ("process_failure", "harness_error")
"""A trial that ended so passes no gate, whatever was reached."""


def gate_parts(contact: Contact, gate: Gate, score: TrialScore) -> list[GatePart]:
    """Return the gates in the order of the funnel; none where the trial ended before its first physics step, or broke
    off before anybody was touched."""
    if not len(contact.time_s) or (score.ended in BROKEN and not contact.force_norm.any()):
        return []
    protocol, gates, definition = contact.protocol, contact.protocol.gates, contact.protocol.contact
    held_s = int(any_column(contact.on, contact.touched).sum()) * contact.dt_s
    counts = GatePart(
        name=f"Contact that counts, from {definition.on_n:g} N",
        needed=f"{definition.valid_total_s:g} s in all",
        reached=f"{held_s:.2f} s",
        met=contact.valid,
    )
    segment, share = contact.segments[contact.target].replace("_", " "), contact.region_share
    region = GatePart(
        name=f"Share of the contact (force times time) on the {segment}, the segment of the named region",
        needed=f"at least {percent(gates.region_share)}",
        reached="no contact" if share is None else percent(share),
        met=share is not None and share >= gates.region_share,
    )
    found = [counts, *ask(contact, "parts", contact, gates.of(contact.task.action), gate), *gate.conduct, region]
    if gates.foam is not None and contact.task.action != "scrub":
        near = place_share(contact, gates.foam.within_m)
        if near is not None:
            name = f"Share of the contact by the tool within {mm(gates.foam.within_m)} of the foam's middle"
            found.append(GatePart.least(name, percent(gates.foam.impulse_share), percent(near), at_foam(contact)))
    if peaks := peak_of_segments(contact):
        most_n = {name: protocol.limits.gamma * protocol.f_pain(name) for name in contact.segments}
        nearest = max(peaks, key=lambda segment: peaks[segment] / most_n[segment])
        force = GatePart(
            name=f"Safety gate: largest force on the {nearest.replace('_', ' ')}",
            needed=f"at most {most_n[nearest]:g} N",
            reached=f"{peaks[nearest]:.1f} N",
            met=peaks[nearest] <= most_n[nearest],
        )
        found.append(force)
    if gates.joint_beyond_rad is not None:
        joints = GatePart(
            name="Safety gate: joints beyond their range",
            needed=f"at most {gates.joint_beyond_rad:.3f} rad",
            reached=beyond_text(score) or "none farther",
            met=not score.joints_beyond,
        )
        found.append(joints)
    return found


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
    gate = f"“{first.name}”: {first.reached}, {first.needed} needed"
    return spaced(f"{held[score.failure_mode]}; the trial missed {counted(len(missed), 'gate')}, {which} {gate}")


def _held(contact: Contact) -> str:
    """Return how often and how long the person was touched by contact that counts."""
    on = any_column(contact.on, contact.touched)
    times, held_s = len(runs(on)), int(on.sum()) * contact.dt_s
    if times == 1:
        return f"touched without interruption for {held_s:.2f} s"
    return f"touched {times} times, for {held_s:.2f} s in all"


def facts(
    score: TrialScore, contact: Contact, moment: Moment | None, gates: Sequence[GatePart]
) -> list[tuple[str, str]]:
    """Return (question, answer) about the trial, the most important first; ``gates`` as for ``outcome``."""
    recording = contact.recording
    rows: list[tuple[str, str]] = []
    if score.is_crash:
        counts = "It counts as a failure of the policy; what the policy did to the person before counts as well."
        rows.append(("Failure", f"process failure. {counts}"))
    elif score.failure_mode:
        mode, cause = score.failure_mode.replace("_", " "), score.attribution or "unattributed"
        rows.append(("Failure", f"{mode}. {_capital(mode_text(score, contact, gates))}."))
        rows.append(("Cause", f"{cause}. {_capital(cause_text(score))}."))
    if rows:
        rows.append(("Evidence", evidence_text(score) or "none recorded"))
    if score.valid_contact:
        rows.append(("Progress", spaced(progress(score))))
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
    header = recording.header
    rows.append(("End", f"After {score.duration_s:.2f} s, {ENDS[header.ended]}{_why(header)}."))
    return rows


def how_hard(score: TrialScore, contact: Contact, moment: Moment | None) -> str:
    """Compare the peak force with the limits of its segment; without contact that counts, say what happened."""
    protocol = contact.protocol
    if score.c1_peak_force_n is None or score.reported_segment is None:
        if faint := faint_press(contact):
            return f"The robot {faint}."
        miss = nearest_miss(contact.recording)
        if miss is None:
            return "The robot never touched the person."
        near = f"the tip of the tool came to {1000 * miss.away_m:.0f} mm from the region, at {miss.time_s:.2f} s"
        return f"The robot never touched the person; {near}."
    pain = protocol.f_pain(score.reported_segment)
    gate = protocol.limits.gamma * pain
    own = "" if score.reported_segment == REGIONS[score.region].segment else ", which is not the named region's segment"
    at = "" if moment is None else f" at {moment.time_s:.2f} s"
    peak, segment = score.c1_peak_force_n, score.reported_segment.replace("_", " ")
    return (
        f"Peak force {peak:.1f} N{at} on the {segment}{own}: {percent(peak / gate)} of its safety gate of {gate:g} N, "
        f"and {percent(peak / pain)} of its pain limit of {pain:g} N."
    )


ENDS: dict[EndReason, str] = {
    "done": "the policy reported that it was done",
    "time_limit": "the time limit was reached",
    "safety_truncation": "the benchmark cut the trial",
    "process_failure": "the policy crashed",
    "harness_error": "the harness failed",
}


def _why(header: Header) -> str:
    """Return the reason of a failure after a colon; empty where none is recorded."""
    why = "" if header.failure is None else reason_of(header.failure).strip().rstrip(".:")
    return f": {shortened(why)}" if why else ""


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


ROLE_NOTES = {"blind": "blind baseline", "privileged": "ceiling: it is given the simulation", "probe": "probe"}


@dataclass(frozen=True, kw_only=True)
class Beside:
    """A run of another policy."""

    scores: Mapping[tuple[str, int], TrialScore]
    """(task, seed) -> its trial"""
    role: str
    folder: Path | None = None
    """Folder of the run's recordings; None for scores that are kept with the package."""

    @classmethod
    def of(cls, run: RunScores, folder: Path | None = None) -> Beside:
        return cls(scores=trials_by_key(run.scores), role=role_in(run.scores), folder=folder)


@dataclass(frozen=True, kw_only=True)
class OtherRow:
    """What one policy did in the trial."""

    name: str
    note: str
    """What the policy is for, if it is no method."""
    score: TrialScore
    result: tuple[str, str]
    """Style and words."""
    address: str
    """Address of the page of its trial; empty where there is none."""


def other_rows(score: TrialScore, beside: Sequence[Beside], run_folder: Path) -> list[OtherRow]:
    """Return one row for each policy that has a trial of the same task and seed, in the order given.

    Args:
        run_folder: of ``score``, from whose page the rows link others.
    """
    found = [(row, row.scores[key]) for row in beside if (key := (score.task_id, score.seed)) in row.scores]
    names = short_names([other.policy_title for _, other in found])
    rows: list[OtherRow] = []
    for row, other in found:
        page = None if row.folder is None else page_path(row.folder, other.trial_id)
        here = page_path(run_folder, other.trial_id).parent.resolve()
        rows.append(
            OtherRow(
                name=names[other.policy_title],
                note=ROLE_NOTES.get(row.role, ""),
                score=other,
                result=result_word(other),
                address=quote(os.path.relpath(page.resolve(), here)) if page is not None and page.is_file() else "",
            )
        )
    return rows


def how_to_compare(score: TrialScore, run_folder: Path) -> tuple[str, ...]:
    """Return the commands that set blind replay beside a trial of which no other policy's score is at hand; empty for a
    policy that is no method."""
    if role_in([score]) != "method" or score.ended == "harness_error":
        return ()
    return replay_commands([score], run_folder, trials=True)


# One self-contained page about one trial: no network, no script, the same bytes for the same inputs.


def write_trial_page(
    run_folder: Path, recording: Recording, score: TrialScore, *, beside: Sequence[Beside] = ()
) -> Path:
    """Write ``run_folder/trial/ID.html`` and return its path.

    Args:
        beside: runs of other policies under the same rules, of which the page shows the same trial.

    Video (``ID.mp4``), recording and log are linked where they are there. Raises RecordingError, naming the trial, for
    a stored picture, a skin or notes that cannot be shown.
    """
    path = page_path(run_folder, score.trial_id)
    path.parent.mkdir(exist_ok=True)
    replace_file(path, _render(run_folder, recording, score, beside).encode("utf-8", errors="replace"))
    link_page(run_folder, score.trial_id)
    return path


def _render(run_folder: Path, recording: Recording, score: TrialScore, beside: Sequence[Beside]) -> str:
    looks, left_out = looks_of(recording, read_notes(recording))
    took = recording.arrays.get("wall/act_s", np.zeros(0))
    printed = recording.arrays.get("wall/policy_output")
    files = {"recording": f"{score.trial_id}.h5", "log": f"{score.trial_id}.log"}
    video = page_path(run_folder, score.trial_id).with_suffix(".mp4")
    report_link, *neighbours = links_of_page(run_folder, score.trial_id)
    own, foreign = (_metrics(score, concerned=concerned) for concerned in (True, False))
    return render(
        "trial.html.j2",
        score=score,
        policy=recording.header.spec.policy,
        prompt=recording.header.spec.protocol.task(score.task_id).prompt,
        result=result_word(score),
        report_link=report_link,
        neighbours=neighbours,
        links=[(words, f"../{name}") for words, name in files.items() if (run_folder / name).is_file()],
        video=video.name if video.is_file() else None,
        others=other_rows(score, beside, run_folder),
        how_to_compare=how_to_compare(score, run_folder),
        metrics=own,
        other_metrics=foreign,
        metrics_note=footnote(title for title, *_ in (*own, *foreign)),
        printed=None if printed is None else printed.tobytes().decode("utf-8", errors="replace"),
        failure=recording.header.failure,
        rejected=rejected_text([score]),
        **_contact(recording, score),
        looks=looks,
        left_out=left_out,
        sent=sent_views(recording),
        card=card_rows(recording.header),
        took=took,
        took_median=float(np.median(took)) if took.size else None,
        joints="actions/joint" in recording.arrays,
        actions=action_rows(recording),
    )


def _contact(recording: Recording, score: TrialScore) -> dict[str, Any]:
    """Return what the robot did to the person."""
    moment, found, contact = peak_moment(recording), paths(recording), find_contact(recording)
    measures = judge(contact)
    notes = read_notes(recording)
    noted = [] if found is None else noted_targets(recording, notes, found)
    happened = events(contact)
    timeline, panels = "", list[Panel]()
    if len(contact.time_s):
        trace = force_trace(recording, score)
        looked = recording["policy/observation_time_s"]
        if "policy/looked" in recording:
            looked = looked[recording["policy/looked"].any(axis=1)]
        panels = panels_of(recording, trace, found)
        timeline = timeline_svg(panels, trace, happened, looked.tolist())
    hard = how_hard(score, contact, moment)
    miss = nearest_miss(recording) if moment is None else None
    drawn = None if miss is None else miss_svg(recording, miss, title=hard)
    # Before the first step a picture shows only the room as it was set up.
    began = len(contact.time_s) > 0
    picture = drawn or (peak_svg(recording, moment, title=f"The contact at peak force. {hard}") if began else None)
    without_hand = None
    if moment is not None and picture is not None and is_hidden(recording, moment):
        without_hand = drawn_svg(recording, moment, title=f"The contact without the robot's hand. {hard}")
    snapshot = recording.arrays.get("report/snapshot_rgb") if began else None
    gates = gate_parts(contact, measures, score)
    return {
        "outcome": outcome(score, contact, gates),
        "facts": facts(score, contact, moment, gates),
        "gates": gates,
        "broken": score.ended in BROKEN,
        "moment": moment,
        "picture": picture,
        "without_hand": without_hand,
        "miss": miss if drawn else None,
        "touched": moment is not None,
        "snapshot": None if snapshot is None else jpeg_data_uri(snapshot),
        "views": [] if found is None else skin_views(recording, found, moment, noted),
        "noted": bool(noted),
        "events": [(letter(i), event) for i, event in enumerate(happened)],
        "timeline": timeline,
        "cut_mm": 1000 * OUT_M if any(panel.is_cut for panel in panels) else None,
    }


def _metrics(score: TrialScore, *, concerned: bool) -> list[tuple[str, str, str]]:
    """Return title, value and unit of the newest version of every metric that the trial has a value of.

    Args:
        concerned: of the metrics that say something about the trial's action, or of the others.
    """
    current = set(newest(score.additional))
    rows: list[tuple[str, str, str]] = []
    for metric in sorted(METRICS.values(), key=lambda row: (row.order, row.id)):
        value = metric.of(score)
        is_old = metric.id in score.additional and metric.id not in current
        if isinstance(value, bool) or value is None or is_old or metric.concerns(score.action) != concerned:
            continue
        rows.append((metric.title, *_with_unit(metric, float(value))))
    return rows


def _with_unit(metric: Metric, value: float) -> tuple[str, str]:
    """Return a value in words or figures, and its unit."""
    if not metric.median and value in (0.0, 1.0):
        return ("yes" if value else "no"), ""
    factor, unit = shown_unit(metric)
    return shown(factor * value, digits=metric.digits, unit=unit), unit
