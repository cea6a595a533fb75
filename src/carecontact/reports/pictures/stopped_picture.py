"""Programs of a trial in which nothing was planned: what stopped them, if anything did, and the programs themselves."""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

from carecontact.recording.notes import Note
from carecontact.recording.schema import Recording
from carecontact.reports.pictures.notes_drawing import CHOSEN, FAINT, INK, language, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINE_IN = 0.22
MAX_LINES, MAX_COLUMNS = 60, 116


def draw_stopped(recording: Recording, notes: list[Note], message: str) -> Figure:
    """``message``: why the trial ended, if it says. The program that it names is shown first, with the line that it
    names marked."""
    from matplotlib.figure import Figure

    said = textwrap.wrap(" ".join(message.split()), MAX_COLUMNS)[:6]
    rows = _program_rows([row for note in notes for row in note.content.get("programs", [])], message)
    left_out = len(rows) - MAX_LINES
    if left_out > 0:
        rows = [*rows[:MAX_LINES], (f"... {left_out} more lines are left out", FAINT)]
    lines = [(line, CHOSEN) for line in said] + [("", INK), *rows]
    height = 1.3 + LINE_IN * (len(lines) + 2)
    figure = Figure(figsize=(13.0, height))
    for k, (line, colour) in enumerate(lines):
        figure.text(0.012, 1 - (1.15 + LINE_IN * k) / height, line, family="monospace", size=10.5, color=colour,
                    va="center", parse_math=False)  # fmt: skip
    figure.text(0.012, 0.16 / height, language(notes), size=10, color=FAINT, va="center")
    method = next((str(note.content["method"]) for note in notes if "method" in note.content), "the policy")
    how = "was stopped before it planned anything" if recording.header.failure else "planned no path"
    title(figure, recording, f"{method} {how}")
    return figure


def _program_rows(programs: list[dict[str, str]], message: str) -> list[tuple[str, str]]:
    """Return lines and their colours: numbered, the one that is to blame in red, its program before the others."""

    def names(row: dict[str, str]) -> bool:
        return f"program {row['role']}: {row['query']} " in " ".join(message.split()) + " "

    found = re.search(r"\(line (\d+):", message)
    rows: list[tuple[str, str]] = []
    for row in sorted(programs, key=names, reverse=True):
        rows += [(f"{row['role']}: {row['query']}"[:MAX_COLUMNS], INK)]
        for number, line in enumerate(row["code"].splitlines(), 1):
            blamed = names(row) and found is not None and int(found[1]) == number
            rows.append((f"{'>' if blamed else ' '}{number:>4}  {line}"[:MAX_COLUMNS], CHOSEN if blamed else FAINT))
        rows.append(("", INK))
    return rows or [("the notes of the recording contain no program", FAINT)]
