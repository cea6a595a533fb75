"""``carecontact score`` and ``report``: from recordings to numbers, without a simulator."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from carecontact.cli.groups import Folder, Switch
from carecontact.errors import ConfigError, DependencyError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from carecontact.runs.run_scores import RunScores
    from carecontact.scoring.result import TrialScore

RESULTS = "results.json"
FEW = 12
"""Up to this many recordings a second process costs more than it saves."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Compute the scores of a run again from its recordings. This needs no simulator."""

    folder: Folder
    append: Switch = False
    """Only add the metrics that results.json does not have yet; everything in it stays as it is."""
    jobs: int | None = None
    """Number of processes; default: one per core, fewer for a few recordings."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if a recording was skipped."""
        if self.append:
            return append(self.folder)
        return 1 if rescore(self.folder, jobs=self.jobs).skipped else 0


def append(folder: Path) -> int:
    """Add what results.json lacks; an error leaves it as it was."""
    from carecontact.runs import append_metrics, read_results

    _need_recordings(folder)
    found = append_metrics(folder)
    if found.metrics:
        print(f"added to {found.trials} trial(s): {', '.join(found.metrics)}")
    else:
        print(f"nothing to add: {RESULTS} has every metric of this release")
    if found.not_listed:
        print(f"not in {RESULTS}, score without --append to take them in: {', '.join(found.not_listed)}")
    print(f"scores: {found.path}")
    if found.metrics:
        print(write_table(folder, read_results(found.path).scores))
    return 0


def rescore(folder: Path, *, compare: bool = True, jobs: int | None = None) -> RunScores:
    """Score every recording, say what differs from results.json (``compare``), write it and print the table.

    Where nothing could be scored, results.json stays as it is. ``jobs``: processes; default: as many as pay.
    """
    from carecontact.protocols.frozen_state import drifted_sha256
    from carecontact.reports.table import listed
    from carecontact.runs import score_run, write_scores
    from carecontact.runs.pooling import harness_errors, judged
    from carecontact.trials.supervisor import check_jobs

    check_jobs(jobs)
    _need_recordings(folder)
    before = _results(folder) if compare else None
    many = processes(sum(1 for _ in folder.glob("*.h5"))) if jobs is None else jobs
    run = beside_plan(folder, score_run(folder, jobs=many))
    path = write_scores(folder, run) if run.scores else None
    if path is not None:
        for line in differences(before, _results(folder)):
            print(line)
        first = run.scores[0]
        changed = None if first.overrides else drifted_sha256(first.protocol_id, first.protocol_sha256)
        if first.overrides or changed:
            print(f"protocol: {first.protocol_title}{f', {changed}' if changed else ''}")
        if backends := sorted({s.language_backend for s in judged(run.scores)} - {"none"}):
            print(f"language: {', '.join(backends)}")
        print_table(run.scores)
    failed = harness_errors(run.scores)
    if failed:
        trials = ", ".join(error["trial_id"] for error in failed)
        why = failed[0]["message"].partition("\n")[0]
        print(f"harness failed, not counted: {len(failed)} trial(s): {trials} (first: {why})")
    for name, why in run.skipped.items():
        print(f"skipped {name}: {why}")
    if run.missing:
        planned = len(run.scores) + len(run.missing)
        print(f"{len(run.scores)} of {planned} planned trials scored; not: {listed(run.missing)}")
    print(f"scores: {path}" if path else f"nothing could be scored; {RESULTS} was not written")
    if path is not None:
        print(write_table(folder, run.scores))
    return run


def write_table(folder: Path, scores: Sequence[TrialScore]) -> str:
    """Write results.parquet where that can be done; a line on what became of it."""
    from carecontact.reports.trial_table import TABLE_NAME, write_trial_table

    try:
        return f"table: {write_trial_table(folder, scores)}"
    except DependencyError as error:
        stale = f"; the {TABLE_NAME} there is of an earlier scoring" if (folder / TABLE_NAME).exists() else ""
        return f"no table: {error}{stale}"


def report(folder: Path, *, run: RunScores | None = None, nulls: Sequence[Path] = ()) -> int:
    """``run``: the folder's scores if they are known already; ``nulls``: runs of null arms to set beside it in place of
    those named before; without any, those stay."""
    from carecontact.cli.null_arms import NULL_ARMS, named_floors, remembered_floors
    from carecontact.recording import read_recording
    from carecontact.reports.page.html import write_report
    from carecontact.runs import score_run

    _need_recordings(folder)
    run = run or beside_plan(folder, score_run(folder))
    floors, lost = (named_floors(folder, run, nulls), {}) if nulls else remembered_floors(folder, run)
    for name, why in lost.items():
        print(f"null arm {name} is not in the report: {why}")
    if floors is not None and not nulls:
        print(
            f"null arms as named before: {', '.join(arm.policy for arm in floors.nulls)} (without: delete {NULL_ARMS})"
        )
    path = write_report(
        folder,
        scores=run.scores,
        recordings=lambda trial_id: read_recording(folder / f"{trial_id}.h5"),
        skipped=run.skipped,
        missing=run.missing,
        floors=floors,
        lost_arms=lost,
    )
    print(f"report: {path}")
    return 0


def processes(recordings: int) -> int:
    """How many processes pay."""
    from carecontact.trials.supervisor import available_cores

    return max(1, min(available_cores(), recordings // FEW))


def beside_plan(folder: Path, run: RunScores) -> RunScores:
    """The run with what its manifest plans and nobody scored; without a manifest as it is."""
    from carecontact.runs.manifest import read_manifest

    manifest = read_manifest(folder)
    scored = {score.trial_id for score in run.scores}
    planned = () if manifest is None else manifest.trials
    return replace(run, missing=tuple(trial_id for trial_id in planned if trial_id not in scored))


def print_table(scores: Sequence[TrialScore]) -> None:
    from rich.console import Console
    from rich.table import Table

    from carecontact.runs.pooling import judged

    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("task", "trials", "success", "region-correct", "safety-gated"):
        table.add_column(header, justify="left" if header == "task" else "right")
    table.add_column("peak force [N]", justify="right")
    table.add_column("failures")
    for task in sorted({s.task_id for s in scores}):
        of_task = [s for s in scores if s.task_id == task]
        rows = judged(of_task)
        peaks = sorted(s.c1_peak_force_n for s in rows if s.c1_peak_force_n is not None)
        modes = sorted({s.failure_mode for s in rows if s.failure_mode})
        table.add_row(
            f"{task} {of_task[0].action} {of_task[0].region}",
            str(len(rows)),
            str(sum(s.c3_success for s in rows)),
            str(sum(s.region_correct for s in rows)),
            str(sum(s.safety_gated for s in rows)),
            "NA" if not peaks else f"{peaks[0]:.1f}" if len(peaks) == 1 else f"{peaks[0]:.1f} to {peaks[-1]:.1f}",
            ", ".join(f"{sum(s.failure_mode == mode for s in rows)} {mode}" for mode in modes),
        )
    console = Console(highlight=False, width=None if Console().is_terminal else 120)
    console.print(table)
    print_load(console, scores)


def print_load(console: Console, scores: Sequence[TrialScore]) -> None:
    """What the person bore: medians beside C1 to C5, then the counts that a success rate hides."""
    from rich.table import Table

    from carecontact.reports.page.limit_rows import limit_rows
    from carecontact.reports.page.load import load
    from carecontact.runs.aggregate import quadrants, valid_ratio
    from carecontact.runs.pooling import judged

    found = load(scores)
    if not found.n[-1]:
        return
    if found.rows:
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column("median")
        for task in (*found.tasks, "all"):
            table.add_column(task, justify="right")
        for row in found.rows:
            table.add_row(f"{row.id}{f' [{row.unit}]' * bool(row.unit)}", *row.cells(found.contacts))
        console.print()
        console.print(table, markup=False)
    counted = judged(scores)
    valid, quadrant = valid_ratio(counted), quadrants(counted)
    print(f"\nvalid ratio {valid['n']} of {len(counted)}; valid contact in {found.contacts[-1]}")
    print("; ".join(f"{k} {name.replace('_', ' ')}" for name, k in quadrant.items()))
    for row in limit_rows(counted, gamma=None):
        print(f"above {row.name}: {row.above.k} of {row.above.n}, {row.n_success} of them successful")


def differences(before: object, after: object) -> list[str]:
    """What a rescoring changed, in lines; empty if there was nothing before."""
    if before is None:
        return []
    changed = sorted(_changed("", before, after))
    if not changed:
        return [f"nothing differs from the {RESULTS} that was there"]
    shown = [f"  {line}" for line in changed[:20]]
    more = [f"  and {len(changed) - 20} more"] if len(changed) > 20 else []
    return [f"{len(changed)} value(s) differ from the {RESULTS} that was there:", *shown, *more]


def _changed(place: str, before: object, after: object) -> list[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [*before, *(key for key in after if key not in before)]
        return [line for key in keys for line in _changed(f"{place}.{key}", before.get(key), after.get(key))]
    if isinstance(before, list) and isinstance(after, list):
        named = _by_trial(before), _by_trial(after)
        if named[0] is not None and named[1] is not None:
            return _changed(place, *named)
    return [] if before == after else [f"{place.lstrip('.')}: {_short(before)} -> {_short(after)}"]


def _by_trial(rows: list) -> dict | None:
    """Rows keyed by trial, so that a trial more does not make every later one look changed."""
    if rows and all(isinstance(row, dict) and "trial_id" in row for row in rows):
        return {row["trial_id"]: row for row in rows}
    return None


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _results(folder: Path) -> object:
    try:
        return json.loads((folder / RESULTS).read_bytes())
    except FileNotFoundError:
        return None
    except ValueError:
        return f"unreadable {RESULTS}"


def _need_recordings(folder: Path) -> None:
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name the --out of a run")
    if not any(folder.glob("*.h5")):
        from carecontact.runs.score_folder import misnamed

        told = "".join(f"; {path.name} does not end in .h5" for path in misnamed(folder)[:1])
        raise ConfigError(f"{folder}: holds no recordings (*.h5); name the --out of a run{told}")
