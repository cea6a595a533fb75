"""Write the pages of trials, for ``carecontact report``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import RecordingError

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores


def write_page_of(file: Path) -> Path:
    """Score one recording, write the page of its trial into the folder ``trial`` beside it, and return the page's path.

    Raises RecordingError, naming the file, for one that cannot be read, scored or drawn.
    """
    from carecontact.recording.reader import read_verified
    from carecontact.reports.trial.page import write_trial_page
    from carecontact.scoring import score_recording

    verified = read_verified(file)
    score = score_recording(verified.recording, sha256=verified.sha256)
    return write_trial_page(file.parent, verified.recording, score)


def write_trial_pages(folder: Path, run: RunScores) -> None:
    """Write the page of every scored trial. A recording that cannot be drawn is named, and the others are drawn."""
    from carecontact.recording import read_recording
    from carecontact.reports.page_links import FOLDER
    from carecontact.reports.trial.page import write_trial_page

    done = 0
    for score in run.scores:
        try:
            write_trial_page(folder, read_recording(folder / f"{score.trial_id}.h5"), score)
            done += 1
        except RecordingError as error:
            print(f"no page of {score.trial_id}: {error}")
    print(f"pages of {done} trial{'' if done == 1 else 's'}: {folder / FOLDER}")
