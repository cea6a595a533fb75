"""Sections that show trials one by one: their table, force traces, and the contact at peak force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from carecontact.interface.regions import REGIONS
from carecontact.protocol.protocol import Protocol
from carecontact.recording.schema import Recording
from carecontact.report.failures import cause_text, evidence_text, only_crashes, progress, result_word
from carecontact.report.force_trace import ForceTrace, force_trace, trace_svg
from carecontact.report.links import link_to_page, shortened
from carecontact.report.miss import Miss, drawn_svg, is_hidden, miss_svg, nearest_miss
from carecontact.report.moment import peak_moment, peak_svg
from carecontact.report.run_page import FAILURES_SHOWN, FOLD, Kept, Page, section, table_script
from carecontact.report.sections.failures import pictured
from carecontact.report.tables import headlines
from carecontact.report.words import NOT_DEFINED, beyond_text, consumed_text, shown, task_name
from carecontact.scoring.contact import faint_press, find_contact
from carecontact.scoring.result import TrialScore

NEAR_LIMIT = 0.5
"""Share of a borrowed safety gate from which on the page names the segment."""
TELLING = 6
"""Number of force traces above the fold."""
WITHOUT_HAND = 'class="skin moment drawn"'
"""Part of a drawing of a contact that the stored picture does not show."""


@dataclass(frozen=True, kw_only=True)
class TrialRow:
    score: TrialScore
    result: tuple[str, str]
    """Style (pass, hard, region, fail or crash) and words."""
    gate: str
    """Force limit of the named region [N]."""
    cells: tuple[str, ...]
    """One for each headline metric; none where no contact counted."""
    progress: str
    notes: tuple[tuple[str, str], ...]
    """Name and text: failure mode and evidence, segments over their gate, segments at NEAR_LIMIT of a gate that is not
    their own, joints beyond their range, and joints that are flagged."""
    link: str
    """Beginning of the link to the page of the trial."""
    files: tuple[tuple[str, str], ...]
    """Words and address of the other files of the trial."""


def keep_nearest(score: TrialScore, recording: Recording, kept: Kept) -> None:
    if not score.valid_contact and (miss := nearest_miss(recording)) is not None:
        kept.setdefault("nearest", {})[score.trial_id] = miss


@section("trials", "Trials", order=40, keep=keep_nearest)
def trials(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    nearest: Mapping[str, Miss] = page.kept["trials"].get("nearest", {})
    rows = [
        trial_row(score, page.protocol, links=page.links, nearest=nearest.get(score.trial_id)) for score in page.judged
    ]
    return {
        "trials": page.trials,
        "rows": rows,
        "labels": [(metric.label, metric.title) for metric in headlines()] if any(row.cells for row in rows) else [],
        "tasks": sorted({row.score.task_id for row in rows}),
        "results": sorted({row.result[1] for row in rows}),
        "pages": any(f"trial/{row.score.trial_id}.html" in page.links for row in rows),
        "script": table_script(),
    }


def trial_row(
    score: TrialScore,
    protocol: Protocol | None,
    *,
    links: Mapping[str, str] | None = None,
    nearest: Miss | None = None,
) -> TrialRow:
    """``protocol``: None where no recording could be read; ``links``: file in the run's folder -> its address."""
    ratios, gate = dict(score.over_limit), NOT_DEFINED
    if protocol is not None:
        gamma = protocol.limits.gamma
        gate = f"{protocol.most_n(score.action, REGIONS[score.region].segment):g}"
        for segment in score.fallback_limits:
            ratios.setdefault(segment, score.peak_force_n[segment] / (gamma * protocol.f_pain(segment)))
    borrowed = {s: ratios[s] for s in score.fallback_limits if ratios.get(s, 0.0) >= NEAR_LIMIT}
    failure = " · ".join(word for word in ((score.failure_mode or "").replace("_", " "), score.attribution) if word)
    evidence = shortened(evidence_text(score) or score.failure_message or "")
    notes = (
        (failure, evidence),
        ("over the safety gate", _ratios(score, score.over_limit, "its safety gate")),
        ("no limit of its own", _ratios(score, borrowed, "the strictest safety gate")),
        ("joint beyond its range", beyond_text(score)),
        ("joint flagged, share of its settled margin used up", consumed_text(score)),
    )
    addresses = links or {}
    files = (
        ("video", f"trial/{score.trial_id}.mp4"),
        ("recording", f"{score.trial_id}.h5"),
        ("log", f"{score.trial_id}.log"),
    )
    reached = progress(score)
    if nearest is not None:
        reached += f"; nearest {1000 * nearest.away_m:.0f} mm from the region, at {nearest.time_s:.1f} s"
    cells = tuple(
        NOT_DEFINED
        if metric.actions is not None and score.action not in metric.actions
        else shown(metric.of(score), digits=metric.digits, unit=metric.unit)
        for metric in headlines()
    )
    return TrialRow(
        score=score,
        result=result_word(score),
        gate=gate,
        cells=cells if score.valid_contact else (),
        progress=reached,
        notes=tuple((name, text) for name, text in notes if text or name == failure != ""),
        link=link_to_page(score.trial_id, is_there=f"trial/{score.trial_id}.html" in addresses),
        files=tuple((words, addresses[name]) for words, name in files if name in addresses),
    )


def _ratios(score: TrialScore, ratio_of: Mapping[str, float], gate: str) -> str:
    return ", ".join(
        f"{segment.replace('_', ' ')} {score.peak_force_n.get(segment, float('nan')):.1f} N = {ratio:.2f} × {gate}"
        for segment, ratio in sorted(ratio_of.items())
    )


def keep_trace(score: TrialScore, recording: Recording, kept: Kept) -> None:
    """The panel of a trial, empty where the robot pressed nothing; none without a physics step."""
    trace = force_trace(recording, score)
    if trace.time_s.size:
        kept[score.trial_id] = trace_svg(trace, title=_alternative(score, trace)) if trace.is_touched else ""


def _alternative(score: TrialScore, trace: ForceTrace) -> str:
    peak = "no valid contact" if score.c1_peak_force_n is None else f"peak {score.c1_peak_force_n:.1f} N"
    gate = f"limit {trace.limits[0].value_n:g} N on the {trace.limits[0].segment}"
    name = f"{score.task_id} {task_name(score)}, seed {score.seed}"
    return f"Force over time, {name}: {peak}, {gate}, {result_word(score)[1]}"


@section("force", "Force over time", order=20, keep=keep_trace)
def telling_traces(page: Page) -> dict[str, Any] | None:
    rows = telling(page)
    return {"traces": rows, "more": len(_drawn(page)) > len(rows)} if rows else None


@section("more force", "Force over time, other trials", order=FOLD + 70)
def other_traces(page: Page) -> dict[str, Any] | None:
    if not page.judged or only_crashes(page.judged):
        return None
    above = {score.trial_id for score, _, _ in telling(page)}
    kept = {trial_id: svg for trial_id, svg in page.kept["force"].items() if trial_id in page.headers}
    found = {
        "traces": [row for row in _drawn(page) if row[0].trial_id not in above],
        "untouched": [score for score in page.shown if kept.get(score.trial_id) == ""],
        "without_trace": [score for score in page.shown if score.trial_id not in kept],
    }
    if not any(found.values()):
        return None
    return found | {"n": len(page.judged), "n_shown": len(page.shown), "failures_shown": FAILURES_SHOWN}


Traced = tuple[TrialScore, tuple[str, str], str]
"""Score, style and words of its result, drawing."""


def _drawn(page: Page) -> list[Traced]:
    """Return the trials with a trace, in the order of the page."""
    kept = page.kept["force"]
    return [
        (s, result_word(s), kept[s.trial_id]) for s in page.shown if s.trial_id in page.headers and kept.get(s.trial_id)
    ]


def telling(page: Page) -> list[Traced]:
    """Return TELLING traces at most: of each kind of result in turn, the worst kind first, the hardest contacts of
    different tasks."""
    kinds = ("crash", "hard", "region", "fail", "pass")
    hardest: dict[tuple[str, str], Traced] = {}
    for row in sorted(_drawn(page), key=lambda row: -max(row[0].peak_force_n.values(), default=0.0)):
        hardest.setdefault((row[1][0], row[0].task_id), row)
    ranked = [[row for (style, _), row in hardest.items() if style == kind] for kind in kinds]
    return [row for turn in zip_longest(*ranked) for row in turn if row is not None][:TELLING]


@dataclass(frozen=True, kw_only=True)
class PeakFrame:
    score: TrialScore
    name: str
    text: str
    svg: str


def keep_frame(score: TrialScore, recording: Recording, kept: Kept) -> None:
    """The hardest trial of each task, and the first of each cause of a failure (attribution and text)."""
    keys = [score.task_id, *([(score.attribution, cause_text(score))] if score.attribution else [])]
    if not all(key in kept for key in keys) and (frame := peak_frame(score, recording)) is not None:
        for key in keys:
            kept.setdefault(key, frame)


@section("peak", "At peak force", order=FOLD + 80, keep=keep_frame)
def frames(page: Page) -> dict[str, Any] | None:
    """The hardest trial of each task whose picture is not above the fold."""
    kept: Mapping[Any, PeakFrame] = page.kept["peak"]
    if not kept or only_crashes(page.judged):
        return None
    above = {frame.score.trial_id for _, frame in pictured(page) if frame is not None}
    found = [kept[task] for task in sorted(key for key in kept if isinstance(key, str))]
    found = [frame for frame in found if frame.score.trial_id not in above]
    if not found:
        return None
    return {
        "frames": found,
        "n": len(page.headers),
        "drawn": any('class="arrow' in frame.svg for frame in found),
        "without_hand": any(WITHOUT_HAND in frame.svg for frame in found),
        "missed": any('class="skin miss"' in frame.svg for frame in found),
    }


def peak_frame(score: TrialScore, recording: Recording) -> PeakFrame | None:
    """Return the picture stored at peak force; None if the trial stored none. Raises RecordingError for a damaged
    one."""
    if "report/peak_rgb" not in recording.arrays:
        return None
    moment = peak_moment(recording)
    when = "" if moment is None else f" at {moment.time_s:.2f}\N{NO-BREAK SPACE}s"
    if score.c1_peak_force_n is None:
        faint = faint_press(find_contact(recording))
        what, when = f"the robot {faint}" if faint else "nothing touched", ""
    else:
        what = f"{score.c1_peak_force_n:.1f} N on the {(score.reported_segment or '').replace('_', ' ')}"
    if moment is not None and moment.depth_m:
        when += f", {1000 * moment.depth_m:.1f} mm deep"
    miss = nearest_miss(recording) if moment is None else None
    if miss is not None:
        when = f"; the tip of the tool came to {1000 * miss.away_m:.0f} mm from the region"
    text, name = f"{what}{when}, seed {score.seed}", f"{score.task_id} {task_name(score)}"
    svg = None if miss is None else miss_svg(recording, miss, title=f"Where the tool came nearest, {name}: {text}")
    title = f"The contact at peak force, {name}: {text}"
    if moment is not None and is_hidden(recording, moment):
        svg = drawn_svg(recording, moment, title=title)
    svg = svg or peak_svg(recording, moment, title=title)
    return None if svg is None else PeakFrame(score=score, name=name, text=text, svg=svg)
