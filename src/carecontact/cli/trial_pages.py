"""Write the pages of trials, for ``carecontact report``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import CarecontactError, RecordingError, counted

if TYPE_CHECKING:
    from carecontact.reports.trial.others import Beside
    from carecontact.runs.run_scores import RunScores


def write_page_of(file: Path) -> Path:
    """Score one recording, write the page of its trial into the folder ``trial`` beside it, and return the page's path.

    Raises RecordingError, naming the file, for one that cannot be read, scored or drawn.
    """
    from carecontact.recording import read_recording
    from carecontact.reports.trial.page import write_trial_page
    from carecontact.runs.run_scores import RunScores
    from carecontact.scoring import score_recording

    recording = read_recording(file)
    score = score_recording(recording)
    beside = policies_beside(file.parent, RunScores(scores=[score]))
    return write_trial_page(file.parent, recording, score, beside=beside)


def write_trial_pages(folder: Path, run: RunScores, *, baselines: Sequence[Path] = ()) -> None:
    """Write the page of every scored trial. A recording that cannot be drawn is named, and the others are drawn.

    Args:
        baselines: runs of blind baselines to show beside the trials; without any, those of the last report.
    """
    from carecontact.recording import open_recording
    from carecontact.reports.page_links import FOLDER
    from carecontact.reports.trial.page import write_trial_page

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
    from carecontact.reports.compare.baselines import check_baselines
    from carecontact.reports.compare.kept import completed_from_kept, kept_for
    from carecontact.reports.trial.others import Beside
    from carecontact.runs.baselines import remembered
    from carecontact.runs.stored_scores import read_scores

    named: list[RunScores] = []
    found: list[Beside] = []
    try:
        places = list(baselines) or list(remembered(folder).values())
    except CarecontactError:
        places = []
    for place in places:
        try:
            scores = read_scores(place)
            check_baselines(run, [*named, scores])
        except CarecontactError:
            continue
        named.append(scores)
        found.append(Beside.of(completed_from_kept(run, scores), place if place.is_dir() else place.parent))
    kept, _ = kept_for(run, named)
    return [*found, *map(Beside.of, kept)]
