"""What a policy noted in a trial, as a picture: a state machine's options, VoxPoser's maps and paths, or the programs
that made none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import ConfigError
from carecontact.plotting import plain_figures
from carecontact.recording.notes import read_notes
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import Recording
from carecontact.reports.pictures.options_picture import draw_options
from carecontact.reports.pictures.sheet import check_sheet_path
from carecontact.reports.pictures.stopped_picture import draw_stopped
from carecontact.reports.pictures.value_maps_picture import draw_value_maps

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 110


@plain_figures()
def save_notes_picture(recording: Recording, path: Path) -> Path:
    """Raises ConfigError for an ending that is not a picture's, or a recording without notes that can be drawn."""
    check_sheet_path(path)
    draw_notes(recording).savefig(path, dpi=DPI, facecolor="white")
    return path


@plain_figures()
def draw_notes(recording: Recording) -> Figure:
    """Raises ConfigError if there is nothing to draw."""
    notes = read_notes(recording)
    trial, failure = recording.header.spec.trial_id, recording.header.failure
    failed = failure.message if failure is not None else ""
    ended = [str(note.content[k]) for note in notes for k in ("ended_without_touching", "ended_because")
             if k in note.content]  # fmt: skip
    for note in notes:
        if "options" in note.content:
            return draw_options(recording, note)
    if any("cost_level" in note.arrays for note in notes):
        return draw_value_maps(recording, notes, ended=failed or "".join(ended[:1]))
    if any("programs" in note.content for note in notes):
        return draw_stopped(recording, notes, failed or "".join(ended[:1]))
    told = ended[0] if ended else reason_of(failure) if failure is not None else ""
    raise ConfigError(f"{trial} has no notes to draw{f': {told}' if told else ''}")
