"""What all pictures of notes share: their title, the frame under them, who wrote the programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.recording.notes import Note
from carecontact.recording.schema import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]

INK, FAINT, CHOSEN = "#1f2a36", "#6b7785", "#ff2f63"


def frame_of(recording: Recording, note: Note) -> U8:
    """(H, W, 3) what the camera took for the step of the note. Raises ConfigError where it was not kept."""
    path = f"policy/frames/{note.observation_index:04d}/{note.content['camera']}/rgb"
    if path not in recording.arrays:
        raise ConfigError(f"{recording.header.spec.trial_id}: {path} is not in the recording")
    return recording[path]


def show_frame(axes: Axes, picture: U8, low: F64, high: F64) -> None:
    """The part of a frame between two corners (2,) [px], enlarged smoothly: its own pixels would show as steps."""
    axes.imshow(picture, interpolation="bicubic")
    axes.set_xticks([])
    axes.set_yticks([])
    last = np.array(picture.shape[1::-1]) - 0.5
    low, high = np.clip(low, -0.5, last), np.clip(high, -0.5, last)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(high[1], low[1])


def title(figure: Figure, recording: Recording, text: str) -> None:
    spec = recording.header.spec
    prompt = spec.protocol.task(spec.task_id).prompt
    height = figure.get_figheight()
    figure.text(0.012, 1 - 0.36 / height, f"“{prompt}”", size=18, weight="bold", color=INK, va="center")
    figure.text(0.012, 1 - 0.70 / height, f"{spec.trial_id}, {spec.protocol.title}: {text}", size=11, color=FAINT,
                va="center")  # fmt: skip


def language(notes: list[Note]) -> str:
    """Who wrote what a language model is asked for, in one line."""
    calls = [call for note in notes for call in note.content.get("language", [])]
    if not calls:
        return "no language model was asked"
    backends = sorted({str(call["backend"]) for call in calls})
    return f"language: {', '.join(backends)}, {len(calls)} completions"
