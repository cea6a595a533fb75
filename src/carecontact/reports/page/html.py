"""One self-contained page about one run: no network, no script, the same bytes for the same inputs."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from carecontact import __version__
from carecontact.errors import RecordingError
from carecontact.protocols.frozen_state import frozen_state
from carecontact.recording.schema import Header, Recording
from carecontact.recording.writer import replace_file
from carecontact.reports.compare.null_floors import NullFloors
from carecontact.reports.page.detail import MAX_TEXT, Frame, TrialDetail, peak_frame, snapshot, trial_detail
from carecontact.reports.page.failures import anatomy, causes, failure_modes
from carecontact.reports.page.funnel import Step, funnel, funnel_svg
from carecontact.reports.page.gate_figures import gamma_svg, gate_panels
from carecontact.reports.page.limit_rows import limit_rows
from carecontact.reports.page.load import load, rounded
from carecontact.reports.page.provenance import cannot_say, provenance_rows
from carecontact.reports.table import COLUMNS, POOLED, sorted_scores, summary_rows
from carecontact.runs.aggregate import quadrants, valid_ratio
from carecontact.runs.pooling import check_one_run, harness_errors, judged
from carecontact.scoring.result import TrialScore

FILE_NAME = "report.html"
FULL_DETAIL = 21
"""Up to this many trials every one is shown in detail."""
FAILURES_SHOWN = 14
"""Beyond FULL_DETAIL: one trial a task, and this many of those that did not pass."""


def write_report(
    run_folder: Path,
    *,
    scores: Sequence[TrialScore],
    recordings: Callable[[str], Recording],
    skipped: Mapping[str, str],
    missing: Sequence[str] = (),
    floors: NullFloors | None = None,
    lost_arms: Mapping[str, str] | None = None,
) -> Path:
    """Write ``run_folder/report.html`` and return its path.

    ``recordings`` maps a trial id to its recording; it is called once for each trial shown in detail and the result
    is dropped before the next, so a long run needs the memory of one. A recording that raises RecordingError is
    named on the page, not fatal. ``skipped`` maps trial ids or file names to why they have no score.
    ``missing``: trials that were planned and have no score.
    ``floors``: null arms to be set beside the run; None: the page says that there are none. ``lost_arms`` maps those
    that belong there to why they are not.
    Trials in which the harness failed are listed in a box of their own and are in no count, row or picture.
    Raises ConfigError if the scores mix protocols, policies or worlds.
    """
    check_one_run(scores)
    everything = sorted_scores(scores)
    ordered = judged(everything)
    chosen = trials_in_detail(ordered)
    headers: list[Header] = []
    frames: dict[str, Frame] = {}
    scene: Frame | None = None
    unread: dict[str, str] = {}
    details: dict[str, TrialDetail] = {}
    for score in hardest_first(chosen):
        try:
            recording = recordings(score.trial_id)
            details[score.trial_id] = trial_detail(score, recording)
            scene = scene or snapshot(score, recording)
            if score.task_id not in frames and (frame := peak_frame(score, recording)) is not None:
                frames[score.task_id] = frame
            headers.append(recording.header)
        except RecordingError as error:
            unread[score.trial_id] = _inside(run_folder, str(error))
            details[score.trial_id] = trial_detail(score, None)
    shown = [details[s.trial_id] for s in chosen]
    steps = funnel(ordered)
    protocol = headers[0].spec.protocol if headers else None
    gamma = None if protocol is None else protocol.limits.gamma
    page = (
        _environment()
        .get_template("report.html.j2")
        .render(
            version=__version__,
            policy=everything[0].policy if everything else None,
            protocol_id=_protocol(everything[0], headers) if everything else None,
            verdict=verdict(steps, everything, missing=len(missing)),
            steps=steps,
            funnel_svg=funnel_svg(steps),
            draft=any(not h.spec.protocol.frozen for h in headers),
            n_tasks=len({s.task_id for s in ordered}),
            columns=COLUMNS,
            rows=summary_rows(everything),
            pooled=POOLED,
            details=shown,
            without_trace=[f"{d.task_id} {d.name}, seed {d.seed}" for d in shown if d.svg is None],
            n=len(ordered),
            all_shown=len(chosen) == len(ordered),
            failures_shown=FAILURES_SHOWN,
            scene=scene,
            frames=[frames[task] for task in sorted(frames)],
            valid=valid_ratio(ordered),
            touched=sum(s.valid_contact for s in ordered),
            quadrants=quadrants(ordered),
            limit_rows=limit_rows(ordered, gamma=gamma),
            load=load(ordered),
            rounded=rounded,
            gamma_svg=gamma_svg(ordered, gamma=gamma),
            panels=gate_panels(ordered, protocol),
            floors=floors,
            modes=failure_modes(ordered),
            causes=causes(ordered),
            anatomy=anatomy(ordered),
            failed=sum(not s.region_correct for s in ordered),
            limits=cannot_say(
                everything,
                headers,
                steps,
                len(skipped),
                missing=missing,
                null_arms=floors is not None,
                lost_arms=sorted(lost_arms or {}),
            ),
            provenance=provenance_rows(ordered or everything, headers),
            read=len(headers),
            skipped=[(name, _inside(run_folder, why)) for name, why in sorted(skipped.items())],
            unread=sorted(unread.items()),
            harness_errors=_shortened(harness_errors(everything), run_folder),
        )
    )
    path = run_folder / FILE_NAME
    replace_file(path, page.encode("utf-8", errors="replace"))
    return path


def _protocol(score: TrialScore, headers: Sequence[Header]) -> str:
    """The protocol's title; where it is none that was frozen under its id, that too."""
    changed = any(frozen_state(h.spec.protocol).startswith("not what") for h in headers)
    return f"{score.protocol_title} (not what was frozen)" if changed else score.protocol_title


def verdict(steps: Sequence[Step], scores: Sequence[TrialScore], *, missing: int = 0) -> str:
    """One sentence that somebody who reads nothing else may quote. ``missing``: planned trials without a score."""
    told = _verdict(steps, scores)
    if not missing:
        return told
    return f"Unfinished, {missing} of {len(scores) + missing} planned trials are missing. So far: {told}"


def _verdict(steps: Sequence[Step], scores: Sequence[TrialScore]) -> str:
    scored = len(scores)
    scores = judged(scores)
    if scored and not scores:
        failed_in = "its only trial" if scored == 1 else f"all {scored} trials"
        return f"The harness failed in {failed_in}, so there is nothing to say about the policy."
    if not steps:
        return "No trial of this run could be scored, so there is nothing to say about the policy."
    success, correct, gated = (s.k for s in steps)
    n = steps[0].n
    policy = scores[0].policy[:80]
    gates = "on the named region and within the force gate"
    if not success:
        what = "did not complete its only trial" if n == 1 else f"completed none of {n} trials"
        touched = sum(s.valid_contact for s in scores)
        return f"{policy} {what}; it touched the person in {touched} of {n}."
    if gated == n:
        return f"{policy} completed {'its only trial' if n == 1 else f'all {n} trials'} {gates}."
    lost = [f"{success - correct} lay off the named region"] * (success > correct)
    lost += [f"{correct - gated} pressed too hard"] * (correct > gated)
    tail = f"; of its {success} success{'es' * (success > 1)}, {' and '.join(lost)}" if lost else ""
    return f"{policy} completed {gated or 'none'} of {n} {'trial' if n == 1 else 'trials'} {gates}{tail}."


def trials_in_detail(ordered: Sequence[TrialScore]) -> list[TrialScore]:
    """All trials of a short run; of a longer one, each task's first and FAILURES_SHOWN that did not pass.

    The failures are taken in turn from all tasks, so that one bad task does not crowd out the others.
    """
    if len(ordered) <= FULL_DETAIL:
        return list(ordered)
    first = {s.task_id: s.trial_id for s in reversed(ordered)}
    chosen = set(first.values())
    rank: Counter[str] = Counter()
    queue: list[tuple[int, str, str]] = []
    for score in ordered:
        if not score.safety_gated and score.trial_id not in chosen:
            queue.append((rank[score.task_id], score.task_id, score.trial_id))
            rank[score.task_id] += 1
    chosen |= {trial_id for _, _, trial_id in sorted(queue)[:FAILURES_SHOWN]}
    return [s for s in ordered if s.trial_id in chosen]


def hardest_first(chosen: Sequence[TrialScore]) -> list[TrialScore]:
    """Hardest contact of each task first: its frame is the one shown."""
    return sorted(chosen, key=lambda s: (s.task_id, -(s.c1_peak_force_n or 0.0), s.seed))


def _shortened(errors: Sequence[Mapping[str, str]], run_folder: Path) -> list[tuple[str, str]]:
    """Trial and first line of what is known; the rest is a traceback, which results.json has."""
    return [(e["trial_id"], _inside(run_folder, e["message"]).partition("\n")[0][:MAX_TEXT]) for e in errors]


def _inside(run_folder: Path, message: str) -> str:
    """The message without the path to the run, so that a run that was moved gives the same page."""
    return message.replace(f"{run_folder}{os.sep}", "")


@cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("carecontact.reports.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
