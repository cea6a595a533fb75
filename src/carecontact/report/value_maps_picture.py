"""The picture of value maps that a policy noted, and what all pictures of notes share."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.interface.geometry import matrix_from_quat, pixels
from carecontact.recording.notes import Note
from carecontact.recording.pictures import Pictures
from carecontact.recording.schema import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]

INK, FAINT, CHOSEN = "#1f2a36", "#6b7785", "#ff2f63"


def frame_of(recording: Recording, note: Note) -> U8:
    """(H, W, 3) what the camera took for the step of the note. Raises ConfigError where it was not kept."""
    key, pictures = (note.observation_index, str(note.content["camera"]), "rgb"), Pictures(recording)
    if key not in pictures:
        place = f"the picture of {key[1]} at observation {key[0]}"
        raise ConfigError(f"{recording.header.spec.trial_id}: {place} is not in the recording")
    return pictures[key]


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
    figure.text(
        0.012, 1 - 0.70 / height, f"{spec.trial_id}, {spec.protocol.title}: {text}", size=11, color=FAINT, va="center"
    )


def language(notes: list[Note]) -> str:
    """Who wrote what a language model is asked for, in one line."""
    calls = [call for note in notes for call in note.content.get("language", [])]
    if not calls:
        return "no language model was asked"
    backends = sorted({str(call["backend"]) for call in calls})
    return f"language: {', '.join(backends)}, {len(calls)} completions"


OBJECTIVE, TARGET, BOX = "#ff9d2e", CHOSEN, "#7df9ff"
LEVELS = {"cost": "cost", "avoidance": "avoided: written and seen", "distance": "distance to the target [voxel]"}
MAX_MOTIONS = 4
"""Rows of a picture; later motions are left out, and it says so."""
NEAR_VOXELS = 2.0
"""A path is drawn whole within this of the upright slice, dotted farther away."""
WIDTH_IN, ROW_IN, TOP_IN, FOOT_IN = 20.0, 4.3, 1.0, 0.75


@dataclass(frozen=True, kw_only=True)
class Motion:
    """One call of ``execute`` that planned: the note of its first plan, with slices, and those of all its looks."""

    first: Note
    looks: list[Note]
    progress: list[dict[str, Any]]
    """Contents of the looks of an objective; the last one may say that the objective was over"""
    objective_m: list[F64]
    """(n, 3) where the tool was sent [m], in base, for each look that pursued an objective"""

    @property
    def paths(self) -> list[tuple[F64, bool]]:
        """(n, 3) in base, and whether it is the first plan's"""
        return [
            (np.array(note.content["path_m"]), note is self.first) for note in self.looks if "path_m" in note.content
        ]

    def in_pixels(self, points_m: F64) -> F64:
        """(n, 3) in base -> (n, 2) where the first look's camera sees them"""
        content = self.first.content
        return pixels(points_m, np.array(content["intrinsics"]), np.array(content["pose_camera_in_base"]))

    @property
    def corners_m(self) -> tuple[F64, F64]:
        """(3,) lowest and highest of the workspace"""
        grid = self.first.content["grid"]
        return np.array(grid["low_m"]), np.array(grid["high_m"])

    @property
    def level_m(self) -> float:
        low, high = self.corners_m
        return float(low[2] + self.first.content["grid"]["level"] / self._last * (high - low)[2])

    @property
    def upright_m(self) -> float:
        low, high = self.corners_m
        return float(low[1] + self.first.content["grid"]["upright"] / self._last * (high - low)[1])

    @property
    def _last(self) -> int:
        return self.first.arrays["cost_level"].shape[0] - 1


def motions_of(recording: Recording, notes: list[Note]) -> list[Motion]:
    firsts = [k for k, note in enumerate(notes) if "cost_level" in note.arrays]
    ends = [*firsts[1:], len(notes)]
    motions: list[Motion] = []
    for k, end in zip(firsts, ends, strict=True):
        looks = [n for n in notes[k:end] if n.content.get("subtask") == notes[k].content["subtask"]]
        # A look that ended an objective may have planned the next motion as well: that note tells both.
        later = [n for n in looks if "progress" in n.content and "path_m" not in n.content]
        over = [n for n in notes[end : end + 1] if later and "progress" in n.content]
        progress = [*later, *over]
        pursued = [n for n in progress if n.content.get("pursuing", n is not progress[-1])]
        motions.append(
            Motion(
                first=notes[k], looks=looks, progress=[n.content for n in progress],
                objective_m=[_sent(recording, n.observation_index) for n in pursued],
            )
        )  # fmt: skip
    return motions


def _sent(recording: Recording, look: int) -> F64:
    """(n, 3) targets that the policy sent at one look"""
    index = recording.arrays.get("actions/observation_index", np.empty(0))
    return recording["actions/pose_tcp_in_base"][index == look, :3] if len(index) else np.empty((0, 3))


def draw_value_maps(recording: Recording, notes: list[Note], *, ended: str = "") -> Figure:
    """``ended``: why the trial stopped, if it did not end by itself."""
    from matplotlib.figure import Figure

    motions = motions_of(recording, notes)
    shown = motions[:MAX_MOTIONS]
    height = TOP_IN + ROW_IN * len(shown) + FOOT_IN
    figure = Figure(figsize=(WIDTH_IN, height))
    for row, motion in enumerate(shown):
        top = height - TOP_IN - ROW_IN * row
        _name(figure, motion, top / height, height)

        def panel(left: float, width: float, bottom: float = 0.45, tall: float = 3.05, top: float = top) -> Axes:
            return figure.add_axes((left / WIDTH_IN, (top - ROW_IN + bottom) / height, width / WIDTH_IN, tall / height))

        picture = frame_of(recording, motion.first)
        for column, name in enumerate(LEVELS):
            _draw_level(panel(0.2 + 4.15 * column, 3.75), motion, name, picture, feet=column == 0)
        _draw_upright(panel(13.05, 3.2), motion)
        for k, draw in enumerate((_draw_speed, _draw_tilt, _draw_last)):
            band = panel(17.15, 2.7, bottom=0.45 + 1.08 * (2 - k), tall=0.76)
            draw(band, motion)
            if k < 2:
                band.set_xticklabels([])
    left_out = f"; {len(motions) - len(shown)} more are left out" if len(motions) > len(shown) else ""
    method = motions[0].first.content["method"]
    title(figure, recording, f"value maps and paths of {method}, one row per motion{left_out}")
    _legend(figure, height, objective=any(motion.objective_m for motion in shown))
    unplanned = len({n.content["subtask"] for n in notes if "progress" in n.content}
                    - {motion.first.content["subtask"] for motion in motions})  # fmt: skip
    last = language(notes)
    if unplanned:
        last += f"; {unplanned} objectives began while the tool touched the person, so they have no maps"
    last += f".   The trial ended because: {' '.join(ended.split())[:230]}" if ended else ""
    figure.text(0.012, 0.16 / height, last, size=9.5, color=CHOSEN if ended else FAINT, va="center", parse_math=False)
    return figure


def _name(figure: Figure, motion: Motion, top: float, height: float) -> None:
    """Two lines over a row: the motion, and the queries that its maps came from."""
    plans = sum("path_m" in look.content for look in motion.looks)
    done = motion.progress
    about = f"{plans} plan{'s' * (plans > 1)}"
    if done:
        about += f"; then “{done[0]['progress']}”: {done[-1]['progress_m']:.2f} of {done[-1]['progress_of_m']:.2f} m"
    maps = "     ".join(f"{kind}: {query}" for kind, query in motion.first.content.get("maps", {}).items())
    figure.text(0.012, top - 0.10 / height, f"“{motion.first.content['subtask']}”  ({about})", size=12.5, color=INK,
                weight="bold", va="center", parse_math=False)  # fmt: skip
    figure.text(0.012, top - 0.36 / height, maps, size=9.5, color=FAINT, va="center", parse_math=False)


def _draw_level(axes: Axes, motion: Motion, name: str, picture: U8, *, feet: bool) -> None:
    """A level slice, as the camera would see it lie in the room, and the paths as it would see them."""
    low, high = motion.corners_m
    box = np.array([(x, y, motion.level_m) for x in (low[0], high[0]) for y in (low[1], high[1])])
    seen = np.concatenate([motion.in_pixels(box), *(motion.in_pixels(path) for path, _ in motion.paths)])
    show_frame(axes, picture, seen.min(axis=0) - 6, seen.max(axis=0) + 6)
    limits = axes.get_xlim(), axes.get_ylim()
    values = seen_level(motion, motion.first.arrays[f"{name}_level"].astype(np.float64), picture.shape[:2])
    ceiling = None if name == "distance" else 1.0
    colours = axes.imshow(values, cmap="viridis", alpha=0.55, interpolation="nearest", vmin=0.0, vmax=ceiling)
    axes.set_xlim(limits[0])
    axes.set_ylim(limits[1])
    assert axes.figure is not None
    axes.figure.colorbar(colours, ax=axes, fraction=0.035, pad=0.015).ax.tick_params(labelsize=7)
    for path, first in motion.paths:
        if first and feet:
            foot = motion.in_pixels(np.column_stack([path[:, :2], np.full(len(path), motion.level_m)]))
            axes.plot(foot[:, 0], foot[:, 1], ":", color="black", lw=1.3)
        _line(axes, motion.in_pixels(path), first=first)
    for way in motion.objective_m:
        place = motion.in_pixels(way)
        axes.plot(place[:, 0], place[:, 1], color=OBJECTIVE, lw=2.2, zorder=4)
    goal = motion.in_pixels(np.array([motion.first.content["target_m"]]))
    axes.scatter(goal[:, 0], goal[:, 1], marker="x", s=60, color=TARGET, zorder=5)
    axes.set_title(f"{LEVELS[name]}, z = {motion.level_m:.2f} m", loc="left", size=9.5, color=INK)


def _line(axes: Axes, points: F64, *, first: bool, style: str = "-") -> None:
    from matplotlib.patheffects import withStroke

    width = 1.9 if first else 0.9
    axes.plot(points[:, 0], points[:, 1], style, color="white", lw=width,
              path_effects=[withStroke(linewidth=width + 1.2, foreground="#222222")])  # fmt: skip


def seen_level(motion: Motion, values: F64, shape: tuple[int, ...]) -> F64:
    """(N, N) values of a level slice -> (H, W) those that each pixel's line of sight meets; NaN beside the slice."""
    content, (low, high), last = motion.first.content, motion.corners_m, values.shape[0] - 1
    pose = np.array(content["pose_camera_in_base"])
    v, u = np.mgrid[: shape[0], : shape[1]]
    sight = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(np.array(content["intrinsics"])).T @ pose[:3, :3].T
    met = pose[:2, 3] + (motion.level_m - pose[2, 3]) / sight[..., 2:] * sight[..., :2]
    voxel = np.rint((met - low[:2]) / (high - low)[:2] * last)
    inside = ((voxel >= 0) & (voxel <= last)).all(axis=-1)
    x, y = np.clip(voxel, 0, last).astype(int).transpose(2, 0, 1)
    return np.where(inside, values[x, y], np.nan)


def _draw_upright(axes: Axes, motion: Motion) -> None:
    """The cost in the upright plane through the target; of the paths only what is in that plane is drawn whole."""
    low, high = motion.corners_m
    values = motion.first.arrays["cost_upright"].astype(np.float64)
    axes.imshow(values.T, origin="lower", aspect="auto", cmap="viridis", vmin=0.0, vmax=1.0,
                extent=(low[0], high[0], low[2], high[2]))  # fmt: skip
    near = NEAR_VOXELS * float((high - low)[1]) / (values.shape[0] - 1)
    for path, first in motion.paths:
        for piece, inside in pieces(path, np.abs(path[:, 1] - motion.upright_m) <= near):
            _line(axes, piece[:, [0, 2]], first=first, style="-" if inside else ":")
    for way in motion.objective_m:
        for piece, inside in pieces(way, np.abs(way[:, 1] - motion.upright_m) <= near):
            axes.plot(piece[:, 0], piece[:, 2], "-" if inside else ":", color=OBJECTIVE, lw=2.2, zorder=4)
    for kind, style in (("velocity", "--"), ("avoidance", "-.")):
        for box in motion.first.content.get("written", {}).get(kind, []):
            _draw_box(axes, motion, box, kind, style)
    target = motion.first.content["target_m"]
    axes.scatter([target[0]], [target[2]], marker="x", s=60, color=TARGET, zorder=5)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[2], high[2])
    axes.set_title(f"cost, upright at y = {motion.upright_m:.2f} m", loc="left", size=9.5, color=INK)
    axes.set_xlabel("x of the base [m]", size=8, labelpad=1)
    axes.set_ylabel("z [m]", size=8)
    axes.tick_params(labelsize=7)


def pieces(path: F64, inside: Any) -> list[tuple[F64, bool]]:
    """(n, 3) and (n,) -> runs of segments that have both ends inside, or not; each begins where the last one ended."""
    both = np.asarray(inside)[:-1] & np.asarray(inside)[1:]
    if not len(both):
        return []
    starts = [0, *(np.flatnonzero(np.diff(both.astype(int))) + 1).tolist(), len(both)]
    return [(path[a : b + 1], bool(both[a])) for a, b in pairwise(starts)]


def _draw_box(axes: Axes, motion: Motion, box: list[float], kind: str, style: str) -> None:
    """What a program wrote round a voxel, where the slice cuts it; nothing for one that fills the workspace."""
    from matplotlib.patches import Rectangle

    low, high = motion.corners_m
    pitch = (high - low) / (motion.first.arrays["cost_level"].shape[0] - 1)
    centre, half = low + np.array(box[:3]) * pitch, box[3] / 100
    if half * 2 >= float((high - low).max()) or abs(centre[1] - motion.upright_m) > half + pitch[1]:
        return
    corner = centre - half
    axes.add_patch(Rectangle((corner[0], corner[2]), 2 * half, 2 * half, fill=False, ls=style, ec=BOX, lw=1.2))
    axes.annotate(f"{kind} {box[4]:g}", (centre[0] + half, min(centre[2] + half, high[2])), (0, 3), size=7.5,
                  textcoords="offset points", color=BOX, ha="right", va="bottom")  # fmt: skip


def _draw_speed(axes: Axes, motion: Motion) -> None:
    _along(axes, motion, "path_speed_m_s", "speed [m/s]")
    axes.set_title("first plan: by the velocity map", loc="left", size=9.5, color=INK)


def _draw_tilt(axes: Axes, motion: Motion) -> None:
    turns = motion.first.content.get("path_quat")
    tilts = None if turns is None else [_tilt_deg(turn) for turn in turns]
    _along(axes, motion, "path_quat", "off straight\ndown [deg]", values=tilts)
    axes.set_title("by the rotation map", loc="left", size=9.5, color=INK)


def _tilt_deg(quat: list[float] | None) -> float:
    if quat is None:
        return float("nan")
    down = matrix_from_quat(np.array(quat))[2, 2]
    return float(np.degrees(np.arccos(np.clip(-down, -1.0, 1.0))))


def _draw_last(axes: Axes, motion: Motion) -> None:
    """What the objective achieved, if there was one, else the gripper."""
    done = motion.progress
    if not done:
        _along(axes, motion, "path_gripper", "gripper")
        axes.set_ylim(-0.1, 1.1)
        axes.set_yticks([0, 1], ["closed", "open"], size=7)
        axes.set_title("by the gripper map", loc="left", size=9.5, color=INK)
        axes.set_xlabel("way along the path [m]", size=8, labelpad=1)
        return
    axes.plot(range(len(done)), [content["progress_m"] for content in done], color=OBJECTIVE, marker="o", ms=3.5)
    axes.axhline(done[0]["progress_of_m"], color=FAINT, lw=0.9, ls="--")
    axes.set_title("objective: done, and wanted (dashed)", loc="left", size=9.5, color=INK)
    axes.set_xlabel("look since the touch", size=8, labelpad=1)
    axes.set_xticks(range(len(done)))
    axes.set_ylabel("[m]", size=8)
    axes.tick_params(labelsize=7)


def _along(axes: Axes, motion: Motion, key: str, label: str, *, values: list[float] | None = None) -> None:
    content = motion.first.content
    axes.tick_params(labelsize=7)
    axes.set_ylabel(label, size=8)
    kept = values if values is not None else content.get(key)
    if kept is None:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.text(
            0.5, 0.5, "not in this recording", size=8, color=FAINT, ha="center", va="center", transform=axes.transAxes
        )
        return
    numbers = np.array([np.nan if v is None else v for v in cast("list[float | None]", kept)])
    steps = np.linalg.norm(np.diff(np.array(content["path_m"]), axis=0), axis=1)
    way = np.cumsum(steps)[-len(numbers) :]
    if np.isnan(numbers).all():
        axes.text(0.5, 0.5, "as it is", size=8, color=FAINT, ha="center", va="center", transform=axes.transAxes)
    axes.plot(way, numbers, color=INK, marker=".", ms=4, lw=1.2)
    axes.set_xlim(0, max(float(way[-1]), 1e-3))
    if key == "path_speed_m_s":
        axes.set_ylim(0, 0.28)
    elif key == "path_quat":
        axes.set_ylim(-5, max(95.0, float(np.nanmax(numbers, initial=0.0)) + 5))


def _legend(figure: Figure, height: float, *, objective: bool) -> None:
    from matplotlib.lines import Line2D

    entries: list[tuple[Line2D, str]] = [
        (Line2D([], [], color="#9aa3ad", lw=3), "first plan, as the camera sees it"),
        (Line2D([], [], color="#9aa3ad", lw=1.2), "plans made after it"),
        (Line2D([], [], color="black", lw=1.3, ls=":"), "its foot, on the level of the slice"),
        (Line2D([], [], color=TARGET, marker="x", lw=0), "target"),
        (Line2D([], [], color="#9aa3ad", lw=1.6, ls=":"), f"upright: more than {NEAR_VOXELS:g} voxels off the plane"),
        (Line2D([], [], color="#2fb7c0", lw=1.2, ls="--"), "box that a program wrote"),
    ]
    if objective:
        entries.append((Line2D([], [], color=OBJECTIVE, lw=2), "sent while the objective led"))
    handles, names = zip(*entries, strict=True)
    figure.legend(handles, names, loc="center left", bbox_to_anchor=(0.005, 0.46 / height), ncols=len(entries),
                  frameon=False, fontsize=9.5, handlelength=2.2, columnspacing=1.6)  # fmt: skip
