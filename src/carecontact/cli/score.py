"""``carecontact score``: scores a folder, writes its results, says what changed, and prints the tables."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, Folder, JsonGroup, Switch
from carecontact.errors import CarecontactError, ConfigError, DependencyError, counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from carecontact.protocol.protocol import Protocol
    from carecontact.report.tables import SummaryRow
    from carecontact.runs.pooling import RunScores
    from carecontact.runs.scoring import Appended, ScoredFile
    from carecontact.scoring.result import TrialScore


# Lists the differences between two results of the same run, one line each.

RESULTS = "results.json"
MOST_LINES = 20


def differences(before: object, after: object) -> list[str]:
    """Return one line for each value that a rescoring changed. The list is empty if there were no earlier results."""
    if before is None:
        return []
    changed = sorted(_changed("", before, after))
    if not changed:
        return [f"nothing differs from the earlier {RESULTS}"]
    shown = [f"  {line}" for line in changed[:MOST_LINES]]
    more = [f"  and {len(changed) - MOST_LINES} more"] if len(changed) > MOST_LINES else []
    return [f"{counted(len(changed), 'value differs', 'values differ')} from the earlier {RESULTS}:", *shown, *more]


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
    """Return the rows by trial, so that one more trial does not make every later one look changed."""
    if rows and all(isinstance(row, dict) and "trial_id" in row for row in rows):
        return {row["trial_id"]: row for row in rows}
    return None


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


# The scores of a run as the terminal shows them.

WIDTH = 120
"""Width of the tables if the output does not go to a terminal [columns]."""


def print_table(run: RunScores, protocol: Protocol | None) -> None:
    """Print counts by task, medians of every metric, and the counts that a success rate hides.

    Args:
        run: at least one score.
        protocol: the run's protocol, from one of its recordings; None if none could be read.
    """
    from carecontact.cli.console import console, plain_table
    from carecontact.report.failures import only_crashes
    from carecontact.report.tables import summary_rows
    from carecontact.runs.pooling import judged

    scores, terminal, table = run.scores, console(WIDTH), plain_table()
    for header in ("task", "trials", "success", "region-\ncorrect", "safety-\ngated", "peak force\n[N]"):
        table.add_column(header, justify="left" if header == "task" else "right")
    *rows, whole = summary_rows(scores, run.unjudged)
    tasks = [row.task_id for row in rows]
    for row in rows:
        of_task = [s for s in scores if s.task_id == row.task_id]
        table.add_row(f"{row.task_id} {row.name.lower()}", *_counts(row), _peaks(of_task))
    terminal.print(table)
    if run.incomplete:
        passed = whole.share(whole.safety_gated)
        told = f"{run.incomplete}: {passed} safety-gated, from all others failed to all others passed; {run.completing}"
        terminal.print(told, soft_wrap=True)
    modes = {task: _modes([s for s in judged(scores) if s.task_id == task]) for task in tasks}
    if any(modes.values()):
        terminal.print("\nfailures", style="bold")
        for task in tasks:
            if modes[task]:
                terminal.print(f"{task}: {modes[task]}")
    if only_crashes(judged(scores)):
        terminal.print("\nthe policy crashed in every trial before any contact, so that there are no medians")
    else:
        _print_medians(scores, terminal)
    _print_counts(run, protocol, terminal)


def _counts(row: SummaryRow) -> list[str]:
    """Return the trials, and how many of them passed each gate: ``9–12`` where three have no verdict."""
    passed = (row.success, row.region_correct, row.safety_gated)
    return [row.trials, *(row.share(k).partition("/")[0] for k in passed)]


def _peaks(of_task: Sequence[TrialScore]) -> str:
    from carecontact.runs.pooling import judged

    peaks = sorted(s.c1_peak_force_n for s in judged(of_task) if s.c1_peak_force_n is not None)
    return "NA" if not peaks else f"{peaks[0]:.1f}" if len(peaks) == 1 else f"{peaks[0]:.1f} to {peaks[-1]:.1f}"


def _modes(scores: Sequence[TrialScore]) -> str:
    found = Counter("crashed" if s.is_crash else s.failure_mode.replace("_", " ") for s in scores if s.failure_mode)
    return ", ".join(f"{count} {mode}" for mode, count in sorted(found.items()))


def _print_medians(scores: Sequence[TrialScore], terminal: Console) -> None:
    """Print the medians in as many tables, one below another, as the width needs."""
    from carecontact.cli.console import plain_table
    from carecontact.report.tables import load

    found = load(scores, headlines=True)
    if not found.rows:
        return
    labels = ["median", *(row.label for row in found.rows)]
    cells = [row.cells(found.contacts) for row in found.rows]
    columns = [list(column) for column in zip((*found.tasks, "all"), *cells, strict=True)]
    while columns:
        table, left = plain_table(), terminal.width - max(map(len, labels))
        table.add_column(labels[0], no_wrap=True)
        shown = 0
        for column in columns:
            left -= max(map(len, column)) + 2
            if left < 0 and shown:
                break
            table.add_column(column[0], justify="right", no_wrap=True)
            shown += 1
        for label, *row in zip(labels[1:], *(column[1:] for column in columns[:shown]), strict=True):
            table.add_row(label, *row)
        terminal.print()
        terminal.print(table)
        columns = columns[shown:]


def _print_counts(run: RunScores, protocol: Protocol | None, terminal: Console) -> None:
    from carecontact.cli.console import plain_table
    from carecontact.report.tables import limit_rows, nursing_rows
    from carecontact.report.words import joint_counts
    from carecontact.runs.pooling import judged, share
    from carecontact.runs.results_file import quadrants, valid_ratio
    from carecontact.scoring.limits import footnote

    counted = judged(run.scores)
    if not counted:
        return
    if run.incomplete:
        terminal.print(f"\n{run.incomplete}; of these:")
    touched = sum(s.valid_contact for s in counted)
    scored = valid_ratio(counted)["n"]
    of_all = share(scored, len(counted), len(run.unjudged))
    terminal.print(f"\ntrials with a trajectory to score: {of_all}; with valid contact: {touched}")
    *found, crashed = quadrants(counted).items()
    terminal.print("; ".join(f"{name.replace('_', ' ')}: {k}" for name, k in found))
    over = sum(s.is_crash and bool(s.over_limit) for s in counted)
    terminal.print(f"crashed: {crashed[1]}" + (f", {over} of them after a force above the safety gate" if over else ""))
    for row in nursing_rows(counted, protocol):
        terminal.print(f"{row.title} ({row.metric}): {row.yes} of {row.n}")
    if joints := joint_counts(counted):
        terminal.print(joints)
    rows = limit_rows(counted, gamma=None, unknown=len(run.unjudged))
    if not rows:
        return
    table = plain_table()
    for header in ("limit", "trials\nabove", "of them\nsuccessful"):
        table.add_column(header, justify="left" if header == "limit" else "right")
    for row in rows:
        table.add_row(row.name, row.count, str(row.n_success))
    terminal.print()
    terminal.print(table)
    if note := footnote(row.name for row in rows):
        terminal.print(note)


# Write the page about a run with its blind baselines, for ``carecontact report`` and ``run``.


def write_page(folder: Path, run: RunScores, *, baselines: Sequence[Path] = ()) -> list[str]:
    """Write report.html and return lines that name it and the baselines that it shows.

    Args:
        run: the scores of the folder.
        baselines: runs of blind baselines to show beside it from now on; without any, the earlier ones stay.

    Raises ConfigError for a baseline that cannot be read or compared; then nothing is written or remembered.
    """
    from carecontact.recording import open_recording
    from carecontact.report.baselines import beside_shipped_scores
    from carecontact.report.run_page import write_report

    named, lost, told = (_named(folder, run, baselines), {}, []) if baselines else _remembered(folder, run)
    beside, why_none = beside_shipped_scores(run, named)
    scored = {score.trial_id: score.recording_sha256 for score in run.scores}
    path = write_report(
        folder,
        scores=run.scores,
        recordings=lambda trial_id: open_recording(folder / f"{trial_id}.h5", sha256=scored[trial_id]),
        skipped=run.skipped,
        missing=run.missing,
        elsewhere=run.elsewhere,
        baselines=beside,
        lost_baselines=lost,
        kept_scores=why_none,
    )
    return [*told, f"report: {path}"]


def _named(folder: Path, run: RunScores, baselines: Sequence[Path]) -> list[RunScores]:
    from carecontact.report.baselines import check_baselines
    from carecontact.runs.results_file import remember
    from carecontact.runs.scoring import read_scores

    found = [read_scores(path) for path in baselines]
    check_baselines(run, found)
    remember(folder, baselines)
    return found


def _remembered(folder: Path, run: RunScores) -> tuple[list[RunScores], dict[str, str], list[str]]:
    """Return the baselines of the last report, each baseline that can no longer be shown -> the reason, and lines about
    both."""
    from carecontact.report.baselines import check_baselines
    from carecontact.runs.results_file import BASELINES, remembered
    from carecontact.runs.scoring import read_scores

    found: list[RunScores] = []
    lost: dict[str, str] = {}
    try:
        places = remembered(folder)
    except ConfigError as error:
        places, lost = {}, {BASELINES: str(error)}
    for name, place in places.items():
        try:
            baseline = read_scores(place)
            check_baselines(run, [*found, baseline])
        except CarecontactError as error:
            lost[name] = str(error)
        else:
            found.append(baseline)
    told = [f"the blind baseline {name} is not in the report: {why}" for name, why in lost.items()]
    if found:
        names = ", ".join(baseline.scores[0].policy_title for baseline in found)
        kept = f"the report keeps the blind baselines of the last report: {names}"
        told.append(f"{kept}; to remove them, delete {folder / BASELINES}")
    return found, lost, told


# Score a folder, write its results and print them, for ``carecontact score`` and ``run``.

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
    from carecontact.running.supervisor import check_jobs
    from carecontact.runs import score_run
    from carecontact.runs.scoring import beside_plan

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
    from carecontact.report.trial_table import TABLE_NAME, write_trial_table

    try:
        return f"table: {write_trial_table(folder, scores)}"
    except DependencyError as error:
        stale = f"; the existing {TABLE_NAME} comes from an earlier scoring" if (folder / TABLE_NAME).exists() else ""
        return f"no table: {error}{stale}"


def processes(recordings: int) -> int:
    """Return the number of processes that saves time."""
    from carecontact.running.workers import available_cores

    return max(1, min(available_cores(), recordings // FEW))


def need_recordings(folder: Path) -> None:
    """Check a run's folder. Raises ConfigError if it does not exist or holds no recordings."""
    if folder.is_file():
        raise ConfigError(f"{folder}: this is a file; name the --out of a run")
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name the --out of a run")
    if not any(folder.glob("*.h5")):
        from carecontact.runs.scoring import misnamed

        told = "".join(f"; {path.name} does not end in .h5" for path in misnamed(folder)[:1])
        raise ConfigError(f"{folder}: holds no recordings (*.h5); name the --out of a run{told}")


def _print_scores(run: RunScores, folder: Path) -> None:
    from carecontact.protocol.lock import drifted_sha256
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
    from carecontact.recording.file import read_header

    paths = (folder / f"{score.trial_id}.h5" for score in scores)
    return next((read_header(path).spec.protocol for path in paths if path.is_file()), None)


def _print_left_out(run: RunScores) -> None:
    from carecontact.report.words import listed

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


# ``carecontact score``: from recordings to numbers, without a simulator.


@dataclass(frozen=True, kw_only=True)
class Score:
    """Compute the scores of a run again from its recordings and write results.json. This needs no simulator."""

    folder: Folder
    append: Switch = False
    """Only add the metrics that results.json does not have yet; everything in it stays as it is."""
    allow_missing: Switch = False
    """Replace results.json even if planned trials have no recording that can be scored."""
    jobs: int | None = None
    """Number of processes; default: one per core, or a smaller number if there are few recordings."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if a recording was skipped, or if results.json stays because planned trials are missing."""
        from carecontact.runs.lock import folder_lock

        with folder_lock(self.folder):
            if self.append:
                return self._appended(append(self.folder))
            run = rescore(self.folder, jobs=self.jobs, allow_missing=self.allow_missing)
        status = 1 if run.skipped or (run.missing and not self.allow_missing) else 0
        self._say(run, wrote=bool(run.scores) and (self.allow_missing or not run.missing), status=status)
        return status

    def _appended(self, found: Appended) -> int:
        from carecontact.runs.scoring import beside_plan, read_results

        status = 1 if found.gone else 0
        if self.output.json:
            run = beside_plan(self.folder, read_results(found.path))
            self._say(run, wrote=bool(found.metrics), status=status, added=found.metrics)
        return status

    def _say(self, run: RunScores, *, wrote: bool, status: int, added: list[str] | None = None) -> None:
        if not self.output.json:
            return
        from carecontact.cli.console import print_answer
        from carecontact.cli.result_answers import ScoreAnswer
        from carecontact.runs.results_file import results

        content = results(run)
        print_answer(
            ScoreAnswer(
                folder=str(self.folder),
                results=str(self.folder / RESULTS) if wrote else None,
                added=added,
                skipped=run.skipped,
                missing=list(run.missing),
                overall=content["overall"] if run.scores else None,
                per_task=content["per_task"],
                status=status,
            )
        )


def append(folder: Path) -> Appended:
    """Add the metrics that results.json lacks. An error leaves the file unchanged."""
    from carecontact.runs import append_metrics, read_results

    need_recordings(folder)
    found = append_metrics(folder)
    if found.metrics:
        print(f"added to {counted(found.trials, 'trial')}: {', '.join(found.metrics)}")
    else:
        print(f"nothing to add: {RESULTS} has every metric of this release")
    if found.gone:
        print(f"warning: no recording of {', '.join(found.gone)}; what {RESULTS} says of it stays as it was")
    if found.not_listed:
        others = ", ".join(found.not_listed)
        print(f"recordings that {RESULTS} does not list (run score without --append to include them): {others}")
    print(f"scores: {found.path}")
    if found.metrics:
        print(write_table(folder, read_results(found.path).scores))
    return found
