"""Score a folder, write its results and print them, for ``carecontact score`` and ``run``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import ConfigError, DependencyError, counted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from carecontact.contract.protocol import Protocol
    from carecontact.runs.run_scores import RunScores
    from carecontact.runs.score_files import ScoredFile
    from carecontact.scoring.result import TrialScore

RESULTS = "results.json"
FEW = 12
"""Number of recordings up to which a second process costs more time than it saves."""


def rescore(
    folder: Path,
    *,
    compare: bool = True,
    jobs: int | None = None,
    allow_missing: bool = True,
    page: bool = False,
    scored: Callable[[Path], ScoredFile | None] = lambda path: None,
) -> RunScores:
    """Score every recording as ``scores_of`` does, and write and print it as ``publish`` does."""
    run = scores_of(folder, jobs=jobs, scored=scored)
    publish(folder, run, compare=compare, allow_missing=allow_missing, page=page)
    return run


def scores_of(
    folder: Path, *, jobs: int | None = None, scored: Callable[[Path], ScoredFile | None] = lambda path: None
) -> RunScores:
    """Score every recording; write and print nothing.

    Args:
        jobs: processes; default: as many as pay.
        scored: the score that a recording has already got, or None to compute it.
    """
    from carecontact.runs import score_run
    from carecontact.runs.stored_scores import beside_plan
    from carecontact.trials.supervisor import check_jobs

    check_jobs(jobs)
    need_recordings(folder)
    many = processes(sum(1 for _ in folder.glob("*.h5"))) if jobs is None else jobs
    return beside_plan(folder, score_run(folder, jobs=many, scored=scored))


def publish(
    folder: Path, run: RunScores, *, compare: bool = True, allow_missing: bool = True, page: bool = False
) -> None:
    """Write results.json and print the table. Where nothing could be scored, results.json stays as it is.

    Every file is written before anything is printed, because standard output may be full.

    Args:
        compare: whether to print what differs from the earlier results.json.
        allow_missing: whether to replace results.json although planned trials have no score.
        page: whether to write report.html, too.
    """
    from carecontact.cli.changes import differences
    from carecontact.cli.report_page import write_page
    from carecontact.runs import write_scores

    before = _results(folder) if compare else None
    kept = not allow_missing and bool(run.missing) and (folder / RESULTS).is_file()
    path = write_scores(folder, run) if run.scores and not kept else None
    written = [write_table(folder, run.scores)] if path is not None else []
    written += write_page(folder, run) if page else []
    if path is not None:
        for line in differences(before, _results(folder)):
            print(line)
        _print_scores(run, folder)
    if run.incomplete and path is None:
        print(run.incomplete)
    _print_left_out(run)
    if kept and run.scores:
        print(f"{folder / RESULTS} was not replaced: --allow-missing replaces it with the scores of what is there")
    else:
        print(f"scores: {path}" if path else f"nothing could be scored; {RESULTS} was not written")
    for line in written:
        print(line)


def write_table(folder: Path, scores: Sequence[TrialScore]) -> str:
    """Write results.parquet if pyarrow is installed. Return one line that says what was written, or why nothing was."""
    from carecontact.reports.trial_table import TABLE_NAME, write_trial_table

    try:
        return f"table: {write_trial_table(folder, scores)}"
    except DependencyError as error:
        stale = f"; the existing {TABLE_NAME} comes from an earlier scoring" if (folder / TABLE_NAME).exists() else ""
        return f"no table: {error}{stale}"


def processes(recordings: int) -> int:
    """Return the number of processes that saves time."""
    from carecontact.trials.workers import available_cores

    return max(1, min(available_cores(), recordings // FEW))


def need_recordings(folder: Path) -> None:
    """Check a run's folder. Raises ConfigError if it does not exist or holds no recordings."""
    if folder.is_file():
        raise ConfigError(f"{folder}: this is a file; name the --out of a run")
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name the --out of a run")
    if not any(folder.glob("*.h5")):
        from carecontact.runs.score_folder import misnamed

        told = "".join(f"; {path.name} does not end in .h5" for path in misnamed(folder)[:1])
        raise ConfigError(f"{folder}: holds no recordings (*.h5); name the --out of a run{told}")


def _print_scores(run: RunScores, folder: Path) -> None:
    from carecontact.cli.score_tables import print_table
    from carecontact.protocols.frozen_state import drifted_sha256
    from carecontact.runs.pooling import judged, mixed, rejected_text

    scores, first = run.scores, run.scores[0]
    changed = None if first.overrides else drifted_sha256(first.protocol_id, first.protocol_sha256)
    if first.overrides or changed:
        print(f"protocol: {first.protocol_title}{f', {changed}' if changed else ''}")
    if backends := sorted({s.language_backend for s in judged(scores)} - {"none"}):
        print(f"language: {', '.join(backends)}")
    print_table(run, _protocol(scores, folder))
    for told in filter(None, (rejected_text(scores), mixed(scores))):
        print(f"warning: {told}")


def _protocol(scores: Sequence[TrialScore], folder: Path) -> Protocol | None:
    """Return the protocol of the run, from a recording that was scored, or None if the folder has none of these."""
    from carecontact.recording.reader import read_header

    paths = (folder / f"{score.trial_id}.h5" for score in scores)
    return next((read_header(path).spec.protocol for path in paths if path.is_file()), None)


def _print_left_out(run: RunScores) -> None:
    from carecontact.reports.text import listed

    for name, why in run.skipped.items():
        print(f"skipped {name}: {why}")
    reasons: dict[str, list[str]] = {}
    for trial, why in run.unjudged.items():
        if f"{trial}.h5" not in run.skipped:
            reasons.setdefault(why.partition("\n")[0], []).append(trial)
    for why, trials in reasons.items():
        print(f"no verdict on {counted(len(trials), 'planned trial')}, {why}: {listed(trials)}")


def _results(folder: Path) -> object:
    try:
        return json.loads((folder / RESULTS).read_bytes())
    except FileNotFoundError:
        return None
    except ValueError:
        return f"unreadable {RESULTS}"
