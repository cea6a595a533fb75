"""``carecontact notes``: a picture of what a policy noted in one trial."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro


@dataclass(frozen=True, kw_only=True)
class Notes:
    """Draw what a policy noted in a trial, on top of the image that it saw: the options and the choice of
    state-machine, or the value maps and paths of voxposer. If voxposer planned nothing, draw its program and what
    stopped it."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL.h5")]
    """Recording of one trial of state-machine, voxposer or voxposer-phased."""
    out: Path | None = None
    """Picture to write, .png, .jpg or .pdf; default: notes-TRIAL.png in the current folder."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Raises ConfigError where there is nothing to draw, RecordingError for a file that is not a recording."""
        from carecontact.recording import read_recording
        from carecontact.reports.pictures.notes_picture import save_notes_picture
        from carecontact.reports.pictures.sheet import check_sheet_path

        path = check_sheet_path(self.out or Path(f"notes-{self.recording.stem}.png"))
        save_notes_picture(read_recording(self.recording), path)
        print(f"{path}: {self.recording.stem}")
        return 0
