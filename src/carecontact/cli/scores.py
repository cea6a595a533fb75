"""The scores of a run as the terminal shows them: the verdict and one table, and with ``--verbose`` everything else."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from carecontact.cli.console import console, plain_table
from carecontact.errors import RecordingError, counted
from carecontact.protocol.lock import drifted_sha256
from carecontact.protocol.protocol import Protocol
from carecontact.recording import open_recording, read_header
from carecontact.report.baselines import ALL, Baselines
from carecontact.report.failures import only_crashes
from carecontact.report.miss import Miss, nearest_miss
from carecontact.report.tables import SummaryRow, limit_rows, load, nursing_rows, summary_rows
from carecontact.report.words import enough_seeds, joint_counts, listed
from carecontact.runs.pooling import RunScores, judged, mixed, over_of, rate_of, rejected_text, share
from carecontact.runs.results_file import RESULTS_NAME, quadrants, valid_ratio
from carecontact.scoring.limits import footnote
from carecontact.scoring.result import TrialScore

WIDTH = 120
"""Width of the tables if the output does not go to a terminal [columns]."""
MOST_LINES = 20
"""Largest number of differences that are printed."""


def print_scores(run: RunScores, folder: Path, beside: Baselines | None, *, verbose: bool) -> None:
    """Print the verdict, a table of the tasks, and warnings; with ``verbose`` also medians and counts."""

    scores, first, terminal = run.scores, run.scores[0], console(WIDTH)
    changed = None if first.overrides else drifted_sha256(first.protocol_id, first.protocol_sha256)
    if changed:
        print(f"protocol: {changed}")
    if verbose and (backends := sorted({s.language_backend for s in judged(scores)} - {"none"})):
        print(f"language: {', '.join(backends)}")
    *rows, whole = summary_rows(scores, run.unjudged)
    terminal.print(_verdict(run, whole, beside), soft_wrap=True)
    if any(s.peak_force_n for s in scores):
        terminal.print(_task_table(run, rows))
    else:
        _print_misses(scores, rows, folder, terminal)
    if verbose:
        _print_medians(scores, terminal)
        _print_counts(run, _protocol(scores, folder), terminal)
    for warning in filter(None, (rejected_text(scores), mixed(scores))):
        print(f"warning: {warning}")


def _verdict(run: RunScores, whole: SummaryRow, beside: Baselines | None) -> str:
    """Return ``hover passes 3 of 7 trials (43 %) of bathing-v3; best blind baseline: replay 2 of 7; ceiling:
    oracle 7 of 7``, where to pass is to be safety-gated."""
    policy, title = run.scores[0].policy_title, run.scores[0].protocol_title
    if run.incomplete:
        passed = whole.share(whole.safety_gated)
        text = f"{passed} safety-gated, from all others failed to all others passed; {run.completing}"
        return f"{policy}, {title}: {run.incomplete}: {text}"
    passed, percent = whole.safety_gated, f"{100 * whole.safety_gated / whole.n:.0f} %"
    if enough_seeds(scores := judged(run.scores)):
        found, over = rate_of(scores, "safety_gated"), "persons" if over_of(scores[0]) == "seeds" else "trials"
        percent += f", 95 % interval over {over} {100 * found.low:.0f} to {100 * found.high:.0f} %"
    rates = [f"{policy} passes {passed} of {counted(whole.n, 'trial')} ({percent}) of {title}"]
    if beside is not None and (floor := beside.floor.get(ALL)):
        name = "best blind baseline" if floor.blind else "best baseline"
        rates.append(f"{name}: {floor.policy} {floor.rate.k} of {floor.rate.n}")
    ceilings = [row for row in beside.baselines if row.role == "privileged"] if beside else []
    rates += [f"ceiling: {row.policy} {row.count('safety_gated')}" for row in ceilings]
    return "; ".join(rates)


def _task_table(run: RunScores, rows: Sequence[SummaryRow]) -> Table:
    """Return the counts of each task: ``9–12`` where three trials have no verdict."""
    headers = ["task", "trials", "success", "region-\ncorrect", "safety-\ngated", "peak force\n[N]"]
    of_tasks = {row.task_id: [s for s in judged(run.scores) if s.task_id == row.task_id] for row in rows}
    failures = {task: _modes(scores) for task, scores in of_tasks.items()}
    if any(failures.values()):
        headers.append("failures")
    table = plain_table(*headers, left=("failures",))
    for row in rows:
        passed = [row.share(k).partition("/")[0] for k in (row.success, row.region_correct, row.safety_gated)]
        cells = [f"{row.task_id} {row.name.lower()}", row.trials, *passed, _peaks(of_tasks[row.task_id])]
        table.add_row(*cells, *([failures[row.task_id]] if any(failures.values()) else []))
    return table


def _peaks(scores: Sequence[TrialScore]) -> str:
    peaks = sorted(s.c1_peak_force_n for s in scores if s.c1_peak_force_n is not None)
    return "none" if not peaks else f"{peaks[0]:.1f}" if len(peaks) == 1 else f"{peaks[0]:.1f} to {peaks[-1]:.1f}"


def _modes(scores: Sequence[TrialScore]) -> str:
    found = Counter("crashed" if s.is_crash else s.failure_mode.replace("_", " ") for s in scores if s.failure_mode)
    return ", ".join(f"{count} {mode}" for mode, count in sorted(found.items()))


def _print_misses(scores: Sequence[TrialScore], rows: Sequence[SummaryRow], folder: Path, terminal: Console) -> None:

    table = plain_table("task", "trials", "nearest [mm]", "at [s]", "in trial", "ended", left=("in trial", "ended"))
    for row in rows:
        of_task = [s for s in scores if s.task_id == row.task_id]
        found = [(miss, s) for s in of_task if (miss := _miss(folder / f"{s.trial_id}.h5"))]
        miss, nearest = min(found, key=lambda each: each[0].away_m, default=(None, of_task[0]))
        place = (
            ("-", "-", "-") if miss is None else (f"{1000 * miss.away_m:.0f}", f"{miss.time_s:.2f}", nearest.trial_id)
        )
        table.add_row(f"{row.task_id} {row.name.lower()}", row.trials, *place, _modes(judged(of_task)))
    terminal.print("the robot never touched the person; the tip of its tool came nearest to the named region here:")
    terminal.print(table)


def _miss(path: Path) -> Miss | None:

    try:
        return nearest_miss(open_recording(path))
    except (RecordingError, OSError):
        return None


def _print_medians(scores: Sequence[TrialScore], terminal: Console) -> None:
    """Print the medians in as many tables, one below another, as the width needs."""

    if only_crashes(judged(scores)):
        terminal.print("\nthe policy crashed in every trial before any contact, so that there are no medians")
        return
    found = load(scores, every=True)
    if not found.rows:
        return
    labels = ["median", *(row.label for row in found.rows)]
    cells = [row.cells(found.contacts) for row in found.rows]
    columns = [list(column) for column in zip((*found.tasks, "all"), *cells, strict=True)]
    while columns:
        left, shown = terminal.width - max(map(len, labels)), 0
        for column in columns:
            left -= max(map(len, column)) + 2
            if left < 0 and shown:
                break
            shown += 1
        heads, *rows = zip(labels, *columns[:shown], strict=True)
        table = plain_table(*heads)
        for column in table.columns:
            column.no_wrap = True
        for row in rows:
            table.add_row(*row)
        terminal.print()
        terminal.print(table)
        columns = columns[shown:]


def _print_counts(run: RunScores, protocol: Protocol | None, terminal: Console) -> None:
    """Print what a success rate hides: contact, safe failures, crashes, joints and forces above limits."""

    scores = judged(run.scores)
    if not scores:
        return
    if run.incomplete:
        terminal.print(f"\n{run.incomplete}; of these:")
    touched = sum(s.valid_contact for s in scores)
    of_all = share(valid_ratio(scores)["n"], len(scores), len(run.unjudged))
    terminal.print(f"\ntrials with a trajectory to score: {of_all}; with valid contact: {touched}")
    *found, crashed = quadrants(scores).items()
    terminal.print("; ".join(f"{name.replace('_', ' ')}: {k}" for name, k in found))
    over = sum(s.is_crash and bool(s.over_limit) for s in scores)
    terminal.print(f"crashed: {crashed[1]}" + (f", {over} of them after a force above the safety gate" if over else ""))
    for row in nursing_rows(scores, protocol):
        terminal.print(f"{row.title} ({row.metric}): {row.yes} of {row.n}")
    if joints := joint_counts(scores):
        terminal.print(joints)
    rows = limit_rows(scores, gamma=None, unknown=len(run.unjudged))
    if rows:
        table = plain_table("limit", "trials\nabove", "of them\nsuccessful")
        for row in rows:
            table.add_row(row.name, row.count, str(row.n_success))
        terminal.print()
        terminal.print(table)
        if note := footnote(row.name for row in rows):
            terminal.print(note)


def _protocol(scores: Sequence[TrialScore], folder: Path) -> Protocol | None:
    """Return the protocol of the run, from a recording that was scored, or None if the folder has none of these."""

    paths = (folder / f"{score.trial_id}.h5" for score in scores)
    return next((read_header(path).spec.protocol for path in paths if path.is_file()), None)


def print_left_out(run: RunScores) -> None:

    for name, why in run.skipped.items():
        print(f"skipped {name}: {why}")
    reasons: dict[str, list[str]] = {}
    for trial, why in run.unjudged.items():
        if f"{trial}.h5" not in run.skipped:
            reasons.setdefault(why.partition("\n")[0], []).append(trial)
    for why, trials in reasons.items():
        print(f"no verdict on {counted(len(trials), 'planned trial')}, {why}: {listed(trials)}")


def read_content(folder: Path) -> object:
    try:
        return json.loads((folder / RESULTS_NAME).read_bytes())
    except FileNotFoundError:
        return None
    except ValueError:
        return f"unreadable {RESULTS_NAME}"


def differences(before: object, after: object) -> list[str]:
    """Return one line for each value that a rescoring changed. The list is empty if there were no earlier results."""
    if before is None:
        return []
    changed = sorted(_changed("", before, after))
    if not changed:
        return [f"nothing differs from the earlier {RESULTS_NAME}"]
    shown = [f"  {line}" for line in changed[:MOST_LINES]]
    more = [f"  and {len(changed) - MOST_LINES} more"] if len(changed) > MOST_LINES else []
    count = counted(len(changed), "value differs", "values differ")
    return [f"{count} from the earlier {RESULTS_NAME}:", *shown, *more]


def _changed(place: str, before: object, after: object) -> list[str]:
    before, after = _by_trial(before), _by_trial(after)
    if isinstance(before, dict) and isinstance(after, dict):
        keys = dict.fromkeys((*before, *after))
        return [line for key in keys for line in _changed(f"{place}.{key}", before.get(key), after.get(key))]
    return [] if before == after else [f"{place.lstrip('.')}: {_short(before)} -> {_short(after)}"]


def _by_trial(rows: object) -> object:
    """Return a list of trials by their ids, so that one more trial does not make every later one look changed."""
    if isinstance(rows, list) and rows and all(isinstance(row, dict) and "trial_id" in row for row in rows):
        return {row["trial_id"]: row for row in rows}
    return rows


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
