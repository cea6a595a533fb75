"""Scores a run's folder, and writes what is known of it: results.json, tables, the report and the pages of trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from carecontact.cli.groups import need_recordings
from carecontact.cli.scores import differences, print_left_out, print_scores, read_content
from carecontact.errors import CarecontactError, ConfigError, DependencyError, RecordingError, counted
from carecontact.interface.policy import LOOK_CONTROLS
from carecontact.interface.regions import REGIONS
from carecontact.protocol.gates import ACTIONS
from carecontact.recording import open_recording, read_header, read_recording
from carecontact.report.baselines import (
    Baselines,
    beside_shipped_scores,
    check_baselines,
    completed_from_shipped_scores,
    shipped_scores_for,
)
from carecontact.report.links import FOLDER
from carecontact.report.run_page import write_report
from carecontact.report.trial_page import Beside, write_trial_page
from carecontact.report.trial_table import TABLE_NAME, write_trial_table
from carecontact.running.supervisor import check_jobs
from carecontact.running.workers import available_cores
from carecontact.runs import score_run, write_scores
from carecontact.runs.pooling import RunScores
from carecontact.runs.results_file import BASELINES, RESULTS_NAME, remember, remembered
from carecontact.runs.scoring import ScoredFile, beside_plan, read_scores
from carecontact.scoring import score_recording
from carecontact.scoring.result import TrialScore

FEW = 12
"""Number of recordings up to which a second process costs more time than it saves."""


def check_rows(folder: Path, run: RunScores) -> None:
    if not run.scores:
        why = next(iter(run.skipped.values()), "there are none")
        raise ConfigError(f"{folder}: no recording can be scored, so no report is written; the first: {why}")
    for score in run.scores:
        if score.action not in ACTIONS or score.region not in REGIONS:
            read_header(folder / f"{score.trial_id}.h5")


def scores_of(
    folder: Path, *, jobs: int | None = None, scored: Callable[[Path], ScoredFile | None] = lambda path: None
) -> RunScores:
    """Score every recording; write and print nothing. ``scored``: the score that a recording already has, or None."""
    check_jobs(jobs)
    need_recordings(folder)
    many = processes(sum(1 for _ in folder.glob("*.h5"))) if jobs is None else jobs
    return beside_plan(folder, score_run(folder, jobs=many, scored=scored))


def processes(recordings: int) -> int:
    return max(1, min(available_cores(), recordings // FEW))


def publish(
    folder: Path,
    run: RunScores,
    *,
    write: bool = True,
    compare: bool = True,
    allow_missing: bool = True,
    page: bool = True,
    baselines: Sequence[Path] = (),
    verbose: bool = False,
) -> bool:
    """Write results.json and report.html, and print the scores. Return whether results.json was written: it stays as it
    was where nothing could be scored.

    Every file is written before anything is printed, because standard output may be full.

    Args:
        write: whether the scores are new; False leaves results.json alone.
        compare: whether to print what differs from the earlier results.json.
        allow_missing: whether to replace results.json although planned trials have no score.
        page: whether to write report.html.
        baselines: runs of blind baselines to show beside the run from now on; without any, the earlier ones stay.
    """

    before = read_content(folder) if compare and write else None
    kept = write and not allow_missing and bool(run.missing) and (folder / RESULTS_NAME).is_file()
    path = write_scores(folder, run) if write and run.scores and not kept else None
    files = [f"scores: {path}", write_table(folder, run.scores)] if path is not None else []
    notes, beside = write_page(folder, run, baselines=baselines) if page else ([], None)
    if path is not None:
        print(*differences(before, read_content(folder)), sep="\n", end="\n" if before is not None else "")
    if run.scores:
        print_scores(run, folder, beside, verbose=verbose)
    elif run.incomplete:
        print(run.incomplete)
    print_left_out(run)
    if kept and run.scores:
        print(f"{folder / RESULTS_NAME} was not replaced: --allow-missing replaces it with the scores of what is there")
    elif write and path is None:
        print(f"nothing could be scored; {RESULTS_NAME} was not written")
    for line in [*(files if verbose else []), *notes]:
        print(line)
    return path is not None


def write_table(folder: Path, scores: Sequence[TrialScore]) -> str:
    """Write results.parquet if pyarrow is installed. Return one line that says what was written, or why nothing was."""
    try:
        return f"table: {write_trial_table(folder, scores)}"
    except DependencyError as error:
        stale = f"; the existing {TABLE_NAME} comes from an earlier scoring" if (folder / TABLE_NAME).exists() else ""
        return f"no table: {error}{stale}"


def write_page(folder: Path, run: RunScores, *, baselines: Sequence[Path] = ()) -> tuple[list[str], Baselines | None]:
    """Write report.html. Return lines that name it and the baselines that it shows, and the policies beside the run.
    Where a baseline cannot be read or compared, nothing is written or remembered."""
    lost: dict[str, str] = {}
    lines: list[str] = []
    if baselines:
        named = [read_scores(path) for path in baselines]
        check_baselines(run, named)
        remember(folder, baselines)
    else:
        named, lost, lines = _remembered(folder, run)
    named += controls_of(folder, run, named)
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
    return [*lines, f"report: {path}"], beside


def controls_of(folder: Path, run: RunScores, named: Sequence[RunScores] = ()) -> list[RunScores]:
    """Return the comparable runs of the same policy under ``run --control``, which lie inside its folder."""
    if not run.scores:
        return []
    places = {name: folder / name for name in LOOK_CONTROLS if (folder / name / RESULTS_NAME).is_file()}
    found, _ = _comparable(places, run)
    known = {one.scores[0].policy_title for one in named}
    controls = [one for name, one in found.items() if one.scores[0].policy == f"{run.scores[0].policy}+{name}"]
    return [one for one in controls if one.scores[0].policy_title not in known]


def _remembered(folder: Path, run: RunScores) -> tuple[list[RunScores], dict[str, str], list[str]]:
    """Return the baselines of the last report, each one that can no longer be shown -> why, and lines about both."""
    try:
        found, lost = _comparable(remembered(folder), run)
    except ConfigError as error:
        found, lost = {}, {BASELINES: str(error)}
    lines = [f"the blind baseline {name} is not in the report: {why}" for name, why in lost.items()]
    if found:
        names = ", ".join(baseline.scores[0].policy_title for baseline in found.values())
        kept = f"the report keeps the blind baselines of the last report: {names}"
        lines.append(f"{kept}; to remove them, delete {folder / BASELINES}")
    return list(found.values()), lost, lines


def _comparable(places: Mapping[str, Path], run: RunScores) -> tuple[dict[str, RunScores], dict[str, str]]:
    """Return the scores of the runs that can stand beside a run, by their names, and why the others cannot."""
    found: dict[str, RunScores] = {}
    lost: dict[str, str] = {}
    for name, place in places.items():
        try:
            scores = read_scores(place)
            check_baselines(run, [*found.values(), scores])
        except CarecontactError as error:
            lost[name] = str(error)
        else:
            found[name] = scores
    return found, lost


def write_page_of(file: Path) -> Path:
    """Score one recording, write the page of its trial into the folder ``trial`` beside it, and return its path."""
    recording = read_recording(file)
    score = score_recording(recording)
    beside = policies_beside(file.parent, RunScores(scores=[score]))
    return write_trial_page(file.parent, recording, score, beside=beside)


def write_trial_pages(folder: Path, run: RunScores, *, baselines: Sequence[Path] = ()) -> None:
    """Write the page of every scored trial. A recording that cannot be drawn is named, and the others are drawn."""
    beside, done = policies_beside(folder, run, baselines), 0
    for score in run.scores:
        try:
            recording = open_recording(folder / f"{score.trial_id}.h5", sha256=score.recording_sha256)
            write_trial_page(folder, recording, score, beside=beside)
            done += 1
        except RecordingError as error:
            print(f"no page of {score.trial_id}: {error}")
    print(f"pages of {counted(done, 'trial')}: {folder / FOLDER}")


def policies_beside(folder: Path, run: RunScores, baselines: Sequence[Path] = ()) -> list[Beside]:
    """Return the runs that the pages of trials show beside a run: the named baselines, or else those of its last
    report, and the kept scores of the shipped policies. One that cannot be read or compared is left out; the report
    says why."""
    try:
        places = {str(place): place for place in baselines} or remembered(folder)
    except CarecontactError:
        places = {}
    named, _ = _comparable(places, run)
    found: list[Beside] = []
    for name, scores in named.items():
        place = places[name] if places[name].is_dir() else places[name].parent
        found.append(Beside.of(completed_from_shipped_scores(run, scores), place))
    kept, _ = shipped_scores_for(run, list(named.values()))
    return [*found, *map(Beside.of, kept)]
