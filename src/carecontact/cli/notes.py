"""``carecontact notes``: a picture of what a policy noted in one trial."""

from __future__ import annotations

from pathlib import Path

from carecontact.recording import read_recording
from carecontact.reports.pictures.notes_picture import save_notes_picture
from carecontact.reports.pictures.sheet import check_sheet_path


def notes(recording: Path, *, out: Path | None) -> int:
    """``out``: default ``notes-<trial>.png`` here. Raises ConfigError where there is nothing to draw, RecordingError
    for a file that is none."""
    path = check_sheet_path(out or Path(f"notes-{recording.stem}.png"))
    save_notes_picture(read_recording(recording), path)
    print(f"{path}: {recording.stem}")
    return 0
