"""What a policy noted, drawn over the picture that it saw: a state machine's options, VoxPoser's maps and paths."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import pixels
from carecontact.errors import ConfigError
from carecontact.recording.notes import Note, read_notes
from carecontact.recording.schema import Recording
from carecontact.reports.sheet import check_sheet_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]

DPI = 110
INK, FAINT = "#1f2a36", "#6b7785"
COLOURS = {"touch": "#35b6ff", "scrub": "#7ee081", "push": "#ff9d2e"}
CHOSEN, PATH, TARGET = "#ff3d6e", "#ffffff", "#ff3d6e"
LEVELS = {"cost": "cost, level with the target", "distance": "distance to the target [voxel]",
          "avoidance": "avoided: written and seen"}  # fmt: skip
MAX_MOTIONS = 4
"""Rows of a picture; later motions are left out, and it says so."""


def save_notes_picture(recording: Recording, path: Path) -> Path:
    """Raises ConfigError for an ending that is no picture's, or a recording without notes that can be drawn."""
    check_sheet_path(path)
    draw_notes(recording).savefig(path, dpi=DPI, facecolor="white")
    return path


def draw_notes(recording: Recording) -> Figure:
    """Raises ConfigError if there is nothing to draw."""
    notes = read_notes(recording)
    trial = recording.header.spec.trial_id
    for note in notes:
        if "options" in note.content:
            return _options(recording, note)
    motions = [note for note in notes if "cost_level" in note.arrays]
    if motions:
        return _maps(recording, notes, motions)
    ended = [str(note.content[k]) for note in notes for k in ("ended_without_touching", "ended_because")
             if k in note.content]  # fmt: skip
    raise ConfigError(f"{trial} has no notes to draw" + (f": {ended[0]}" if ended else ""))


def _options(recording: Recording, note: Note) -> Figure:
    from matplotlib.figure import Figure

    content = note.content
    options: list[dict[str, Any]] = content["options"]
    chosen = content.get("chosen")
    figure = Figure(figsize=(13.0, 7.6))
    axes = figure.add_axes((0.01, 0.02, 0.66, 0.86))
    picture = _picture(recording, note)
    axes.imshow(picture)
    for k, option in enumerate(options):
        _option(axes, option, bold=k == chosen)
    _zoom(axes, np.concatenate([np.array(o["corners_px"]) for o in options]), picture)
    _title(figure, recording, f"{len(options)} options of {content['method']}, the chosen one in red")
    rows = [f"intent    {' '.join(str(v) for v in content['intent'].values())}", ""]
    if chosen is not None:
        taken = options[chosen]
        rows += [f"chosen    {chosen} of 0-{len(options) - 1}"]
        rows += [f"  {name:<12}{value}" for name, value in taken.items() if not name.startswith("corners")]
    else:
        rows += ["nothing was chosen"]
    rows += ["", "offered", *_counts(options), "", *_spoken([note])]
    figure.text(0.69, 0.86, "\n".join(rows), family="monospace", size=10, color=INK, va="top", linespacing=1.5)
    return figure


def _option(axes: Axes, option: dict[str, Any], *, bold: bool) -> None:
    way = np.array(option["corners_px"])
    colour = CHOSEN if bold else COLOURS.get(option["primitive"], FAINT)
    width, order = (2.6, 4) if bold else (0.9, 2)
    axes.plot(way[:, 0], way[:, 1], color=colour, lw=width, alpha=1.0 if bold else 0.55, zorder=order)
    axes.scatter(way[:1, 0], way[:1, 1], s=70 if bold else 18, color=colour, edgecolors="black", linewidths=0.6,
                 alpha=1.0 if bold else 0.7, zorder=order + 1)  # fmt: skip


def _counts(options: list[dict[str, Any]]) -> list[str]:
    rows = []
    for primitive in COLOURS:
        same = [o for o in options if o["primitive"] == primitive]
        if same:
            depths = sorted({f"{o['depth_m'] * 1000:g}" for o in same})
            rows.append(f"  {primitive:<7}{len(same):>3}   depths {', '.join(depths)} mm")
    return rows


def _maps(recording: Recording, notes: list[Note], motions: list[Note]) -> Figure:
    from matplotlib.figure import Figure

    shown = motions[:MAX_MOTIONS]
    columns = len(LEVELS) + 1
    height = 3.6 * len(shown) + 1.5
    figure = Figure(figsize=(17.0, height))
    for row, note in enumerate(shown):
        top = (height - 1.1 - 3.6 * row) / height
        until = motions[row + 1].observation_index if row + 1 < len(motions) else np.inf
        later = [n for n in notes if note.observation_index <= n.observation_index < until and "path_px" in n.content]
        picture = _picture(recording, note)
        for column, name in enumerate(LEVELS):
            axes = figure.add_axes(
                (0.005 + column / columns, top - 3.15 / height, 0.99 / columns - 0.005, 2.85 / height)
            )
            _level(axes, note, name, later, picture)
            axes.set_title(LEVELS[name], loc="left", size=10, color=INK)
        axes = figure.add_axes((0.03 + (columns - 1) / columns, top - 3.0 / height, 0.85 / columns, 2.6 / height))
        _upright(axes, note, later)
        figure.text(0.006, top - 0.08 / height, f"“{note.content['subtask']}”", size=12, color=INK, weight="bold")
    left_out = f"; {len(motions) - len(shown)} more are left out" if len(motions) > len(shown) else ""
    _title(figure, recording, f"value maps and paths of {motions[0].content['method']}, a row a motion{left_out}")
    figure.text(0.006, 0.25 / height, "   ".join(_spoken(notes)), family="monospace", size=8.5, color=FAINT)
    return figure


def _level(axes: Axes, note: Note, name: str, later: list[Note], picture: U8) -> None:
    """A level slice, as the camera would see it lie in the room."""
    content = note.content
    axes.imshow(picture)
    values = _seen_level(note, note.arrays[f"{name}_level"].astype(np.float64), picture.shape[:2])
    colours = axes.imshow(values, cmap="viridis", alpha=0.55, interpolation="nearest")
    assert axes.figure is not None
    axes.figure.colorbar(colours, ax=axes, fraction=0.035, pad=0.01).ax.tick_params(labelsize=7)
    for other in later:
        way = np.array(other.content["path_px"])
        first = other is note
        axes.plot(way[:, 0], way[:, 1], color=PATH, lw=2.0 if first else 0.8, alpha=1.0 if first else 0.7)
    goal = pixels(np.array([content["target_m"]]), np.array(content["intrinsics"]),
                  np.array(content["pose_camera_in_base"]))  # fmt: skip
    axes.scatter(goal[:, 0], goal[:, 1], marker="x", s=60, color=TARGET, zorder=5)
    _frame(axes, picture)


def _seen_level(note: Note, values: F64, shape: tuple[int, ...]) -> F64:
    """(N, N) values of a level slice -> (H, W) those that each pixel's line of sight meets; NaN beside the slice."""
    grid, content = note.content["grid"], note.content
    low, high, last = np.array(grid["low_m"]), np.array(grid["high_m"]), values.shape[0] - 1
    pose = np.array(content["pose_camera_in_base"])
    v, u = np.mgrid[: shape[0], : shape[1]]
    sight = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(np.array(content["intrinsics"])).T @ pose[:3, :3].T
    height = low[2] + grid["level"] / last * (high - low)[2]
    met = pose[:2, 3] + (height - pose[2, 3]) / sight[..., 2:] * sight[..., :2]
    voxel = np.rint((met - low[:2]) / (high - low)[:2] * last)
    inside = ((voxel >= 0) & (voxel <= last)).all(axis=-1)
    x, y = np.clip(voxel, 0, last).astype(int).transpose(2, 0, 1)
    return np.where(inside, values[x, y], np.nan)


def _upright(axes: Axes, note: Note, later: list[Note]) -> None:
    """The cost in the upright plane through the target, with the paths seen from the side."""
    grid, content = note.content["grid"], note.content
    low, high = np.array(grid["low_m"]), np.array(grid["high_m"])
    axes.imshow(note.arrays["cost_upright"].astype(np.float64).T, origin="lower", aspect="auto", cmap="viridis",
                extent=(low[0], high[0], low[2], high[2]))  # fmt: skip
    for other in later:
        way = np.array(other.content["path_m"])
        axes.plot(way[:, 0], way[:, 2], color=PATH, lw=2.0 if other is note else 0.8, marker=".", ms=4)
    axes.scatter([content["target_m"][0]], [content["target_m"][2]], marker="x", s=60, color=TARGET, zorder=5)
    axes.set_title("cost, upright through the target", loc="left", size=10, color=INK)
    axes.set_xlabel("x of the base [m]", size=8)
    axes.set_ylabel("z [m]", size=8)
    axes.tick_params(labelsize=7)


def _picture(recording: Recording, note: Note) -> U8:
    """Raises ConfigError where the frame was not kept."""
    path = f"policy/frames/{note.observation_index:04d}/{note.content['camera']}/rgb"
    if path not in recording.arrays:
        raise ConfigError(f"{recording.header.spec.trial_id}: {path} is not in the recording")
    return recording[path]


def _spoken(notes: list[Note]) -> list[str]:
    calls = [call for note in notes for call in note.content.get("language", [])]
    if not calls:
        return ["no language model was asked"]
    backends = sorted({str(call["backend"]) for call in calls})
    return [f"language  {', '.join(backends)}", f"  {len(calls)} completions"]


def _title(figure: Figure, recording: Recording, text: str) -> None:
    spec = recording.header.spec
    prompt = spec.protocol.task(spec.task_id).prompt
    height = figure.get_figheight()
    figure.text(0.006, 1 - 0.38 / height, f"“{prompt}”", size=18, weight="bold", color=INK, va="center")
    figure.text(0.006, 1 - 0.72 / height, f"{spec.trial_id}, {spec.protocol.title}: {text}", size=11, color=FAINT,
                va="center")  # fmt: skip


def _zoom(axes: Axes, places: F64, picture: U8) -> None:
    _frame(axes, picture)
    low, high = places.min(axis=0) - 60, places.max(axis=0) + 60
    axes.set_xlim(max(low[0], 0), min(high[0], picture.shape[1]))
    axes.set_ylim(min(high[1], picture.shape[0]), max(low[1], 0))


def _frame(axes: Axes, picture: U8) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_xlim(-0.5, picture.shape[1] - 0.5)
    axes.set_ylim(picture.shape[0] - 0.5, -0.5)
