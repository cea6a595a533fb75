"""A picture of what a policy noted in one trial: options of a state machine, value maps, or where it stopped."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carecontact.errors import ConfigError
from carecontact.plotting import plain_figures
from carecontact.recording.notes import Note, read_notes
from carecontact.recording.reason import reason_of
from carecontact.recording.schema import Recording
from carecontact.report.look_sheet import check_sheet_path
from carecontact.report.value_maps_picture import (
    CHOSEN,
    F64,
    FAINT,
    INK,
    draw_value_maps,
    frame_of,
    language,
    show_frame,
    title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


NOT_OFFERED = "·"
COLOURS = {"touch": "#1f8fe0", "scrub": "#2ca25f", "push": "#e8770c"}
DEPTHS = {"touch": "mm below the seen skin", "scrub": "mm below the seen skin", "push": "mm past the limb's seen side"}
"""What an option's depth is."""
MIN_CROP_PX = 170
"""Least size of the part of a frame that is shown: a narrower one would be enlarged beyond what it shows."""
WIDTH_IN, HEIGHT_IN = 15.5, 8.6


@dataclass(frozen=True, kw_only=True)
class Place:
    """Options that differ in depth and speed alone."""

    letter: str
    primitive: str
    approach: str
    key_point: float
    options: dict[tuple[float, float], int]
    """(depth, speed) -> number of the option"""
    ways_px: list[F64]

    @property
    def down_px(self) -> F64:
        """(2,) where the tool comes down, the mean over the depths"""
        return np.mean([way[0] for way in self.ways_px], axis=0)


def places(options: list[dict[str, Any]]) -> list[Place]:
    """Return the places of the options in the order in which they were offered."""
    found: dict[tuple[str, str, float], list[int]] = {}
    for k, option in enumerate(options):
        found.setdefault((option["primitive"], option["approach"], option["key_point"]), []).append(k)
    return [
        Place(
            letter=chr(ord("A") + n), primitive=primitive, approach=approach, key_point=key,
            options={(options[k]["depth_m"], options[k]["speed_m_s"]): k for k in numbers},
            ways_px=[np.array(options[k]["corners_px"]) for k in numbers],
        )
        for n, ((primitive, approach, key), numbers) in enumerate(found.items())
    ]  # fmt: skip


def draw_options(recording: Recording, note: Note) -> Figure:
    from matplotlib.figure import Figure

    options: list[dict[str, Any]] = note.content["options"]
    chosen: int | None = note.content.get("chosen")
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
    side = (HEIGHT_IN - 1.15) / HEIGHT_IN
    axes = figure.add_axes((0.012, 0.02, side * HEIGHT_IN / WIDTH_IN, side))
    at = places(options)
    low, high = _crop(np.concatenate([way for place in at for way in place.ways_px]))
    show_frame(axes, frame_of(recording, note), low, high)
    for place in at:
        _draw_place(axes, place, chosen)
    _name_places(axes, at, chosen)
    table = figure.add_axes((0.53, 0.02, 0.46, side))
    table.set_axis_off()
    table.set_xlim(0, 1)
    rows = _draw_table(table, at, chosen)
    stated: dict[str, Any] = note.content["intent"]
    words = [str(stated[k]).replace("_", " ") for k in ("action", "side", "region", "manner") if k in stated]
    intent = " ".join(word for word in words if word != "none")
    choice = f"chosen: {chosen}, in red" if chosen is not None else "nothing was chosen"
    dots = any(t.get_text() == NOT_OFFERED for t in table.texts)
    gaps = "; a dot: out of reach or outside the workspace" if dots else ""
    for k, line in enumerate((f"intent: {intent}", f"{choice}{gaps}", language([note]))):
        table.text(0, rows + 0.9 + 0.85 * k, line, size=10.5, color=INK, va="center")
    table.set_ylim(max(rows + 4.0, 16), -0.2)
    title(figure, recording, f"{len(options)} options of {note.content['method']} at {len(at)} places")
    return figure


def _crop(points: F64) -> tuple[F64, F64]:
    """Return a square round all ways, with room for their letters."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = max(float((high - low).max()) * 0.8, MIN_CROP_PX / 2)
    middle = (low + high) / 2
    return middle - half, middle + half


def _draw_place(axes: Axes, place: Place, chosen: int | None) -> None:
    colour = COLOURS.get(place.primitive, FAINT)
    for (_, number), way in zip(place.options.items(), place.ways_px, strict=True):
        bold = number == chosen
        axes.plot(way[:, 0], way[:, 1], color=CHOSEN if bold else colour, lw=3.0 if bold else 1.4,
                  alpha=1.0 if bold else 0.8, zorder=4 if bold else 2)  # fmt: skip
    bold = chosen in place.options.values()
    axes.scatter(*place.down_px, s=120 if bold else 42, color=CHOSEN if bold else colour, edgecolors="white",
                 linewidths=1.2, zorder=6 if bold else 5)  # fmt: skip


def _name_places(axes: Axes, at: list[Place], chosen: int | None) -> None:
    """Letters in a column at each side, where they cannot hide one another, with a thread to the place."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    columns = {0: [p for p in at if p.primitive != "scrub"], 1: [p for p in at if p.primitive == "scrub"]}
    for column, members in columns.items():
        ordered = sorted(members, key=lambda place: float(place.down_px[1]))
        for n, place in enumerate(ordered):
            x = left + (right - left) * (0.05, 0.95)[column]
            y = top + (bottom - top) * (n + 1) / (len(ordered) + 1)
            bold = chosen in place.options.values()
            colour = CHOSEN if bold else COLOURS.get(place.primitive, FAINT)
            down = place.down_px
            axes.plot([x, down[0]], [y, down[1]], color=colour, lw=1.0 if bold else 0.6, alpha=0.9, zorder=3)
            axes.text(x, y, place.letter, size=11, weight="bold", color="white", ha="center", va="center", zorder=7,
                      bbox={"boxstyle": "circle,pad=0.25", "facecolor": colour, "edgecolor": "white"})  # fmt: skip


def _draw_table(axes: Axes, at: list[Place], chosen: int | None) -> float:
    """Draw one block for each primitive: places down, depth and speed across, and in each cell the option's number.
    Return the height in rows."""
    y = 0.4
    for primitive in dict.fromkeys(place.primitive for place in at):
        members = [place for place in at if place.primitive == primitive]
        columns = sorted({key for place in members for key in place.options})
        colour = COLOURS.get(primitive, FAINT)
        axes.plot([0.0, 0.045], [y, y], color=colour, lw=4, solid_capstyle="butt")
        axes.text(0.06, y, primitive, size=13, weight="bold", color=colour, va="center")
        axes.text(0.17, y, DEPTHS.get(primitive, ""), size=9.5, color=FAINT, va="center")
        xs = [0.53 + 0.47 * (k + 0.5) / len(columns) for k in range(len(columns))]
        for x, (depth, speed) in zip(xs, columns, strict=True):
            axes.text(x, y + 0.15, f"{depth * 1000:g} mm\n{speed * 100:g} cm/s", size=9, color=INK, ha="center",
                      va="center", linespacing=1.25)  # fmt: skip
        y += 1.0
        for place in members:
            axes.text(0.03, y, place.letter, size=10, weight="bold", color=colour, va="center", ha="center")
            where = f"{place.approach.replace('_', ' ')}, {place.key_point:g} along the region"
            axes.text(0.06, y, where, size=10, color=INK, va="center")
            for x, key in zip(xs, columns, strict=True):
                _draw_cell(axes, x, y, place.options.get(key), chosen)
            y += 0.85
        y += 0.55
    return y


def _draw_cell(axes: Axes, x: float, y: float, number: int | None, chosen: int | None) -> None:
    if number is None:
        axes.text(x, y, NOT_OFFERED, size=12, color=FAINT, ha="center", va="center")
        return
    bold = number == chosen
    box = {"boxstyle": "round,pad=0.3", "facecolor": CHOSEN if bold else "#eef1f4",
           "edgecolor": CHOSEN if bold else "#d5dbe1"}  # fmt: skip
    axes.text(x, y, f"{number:>2}", size=10, family="monospace", weight="bold" if bold else "normal",
              color="white" if bold else INK, ha="center", va="center", bbox=box)  # fmt: skip


LINE_IN = 0.22
MAX_LINES, MAX_COLUMNS = 60, 116


def draw_stopped(recording: Recording, notes: list[Note], message: str) -> Figure:
    """``message``: why the trial ended, if it says. The program that it names is shown first, with the line that it
    names marked."""
    from matplotlib.figure import Figure

    reason = textwrap.wrap(" ".join(message.split()), MAX_COLUMNS)[:6]
    rows = _program_rows([row for note in notes for row in note.content.get("programs", [])], message)
    left_out = len(rows) - MAX_LINES
    if left_out > 0:
        rows = [*rows[:MAX_LINES], (f"... {left_out} more lines are left out", FAINT)]
    lines = [(line, CHOSEN) for line in reason] + [("", INK), *rows]
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


# What a policy noted in a trial, as a picture: a state machine's options, VoxPoser's maps and paths, or the programs
# that made none.

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
    ended = [
        str(note.content[k]) for note in notes for k in ("ended_without_touching", "ended_because") if k in note.content
    ]
    for note in notes:
        if "options" in note.content:
            return draw_options(recording, note)
    if any("cost_level" in note.arrays for note in notes):
        return draw_value_maps(recording, notes, ended=failed or "".join(ended[:1]))
    if any("programs" in note.content for note in notes):
        return draw_stopped(recording, notes, failed or "".join(ended[:1]))
    why = ended[0] if ended else reason_of(failure) if failure is not None else ""
    raise ConfigError(f"{trial} has no notes to draw{f': {why}' if why else ''}")
