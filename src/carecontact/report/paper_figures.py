"""The paper's figures from any runs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carecontact.errors import counted
from carecontact.interface.regions import REGIONS
from carecontact.plotting import plain_figures
from carecontact.report.moment import region_column, region_poses
from carecontact.report.words import short_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from carecontact.recording.schema import Recording
    from carecontact.report.paper_method import Method
    from carecontact.scoring.result import TrialScore


# One style for the figures, and their files: the same content gives the same bytes.

# Okabe and Ito's palette: colour-blind readers can distinguish its colours, also in print.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY, PALE = "#555555", "#DDDDDD"
STYLE: dict[str, Any] = {
    "font.size": 8, "axes.titlesize": 8.5, "axes.labelsize": 8, "legend.fontsize": 7, "xtick.labelsize": 7,
    "ytick.labelsize": 7, "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.7,
    "lines.linewidth": 1.1, "legend.frameon": False, "axes.grid": True, "grid.color": "0.92", "grid.linewidth": 0.5,
    "axes.titlelocation": "left", "axes.axisbelow": True,
    # Fixed ids and embedded letters, so that a file does not depend on when or where it was made.
    "svg.hashsalt": "carecontact", "svg.fonttype": "path", "pdf.fonttype": 42,
}  # fmt: skip
HASHED_ID = re.compile(r'(?<=[#"])(?:p|m|image|C|h)[0-9a-f]{10}(?=[")])')
"""An id that matplotlib makes of content, where it is defined and where it is used."""
NO_DATE = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}


def write_figure(draw: Callable[[Figure], None], folder: Path, name: str) -> list[Path]:
    """Write what ``draw`` puts on a figure as NAME.svg and NAME.pdf. Returns both paths."""
    with plain_figures(STYLE):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        paths: list[Path] = []
        for ending, metadata in NO_DATE.items():
            paths.append(folder / f"{name}.{ending}")
            figure.savefig(paths[-1], metadata=metadata)
        _number_ids(folder / f"{name}.svg")
    return paths


def _number_ids(svg: Path) -> None:
    """Name ids by their order. matplotlib names a clip by all digits of its place, and the last ones of a layout differ
    from drawing to drawing."""
    text = svg.read_text(encoding="utf-8")
    found = dict.fromkeys(HASHED_ID.findall(text))
    numbers = {hashed: f"{hashed[:-10]}{number}" for number, hashed in enumerate(found)}
    svg.write_text(HASHED_ID.sub(lambda match: numbers[match[0]], text), encoding="utf-8")


def letter(axes: Axes, index: int, title: str) -> None:
    """Name a panel ``(a) title``."""
    axes.set_title(f"({'abcdefghijklmnopqrstuvwxyz'[index]}) {title}")


def colour_of(place: int) -> str:
    """Return the colour of a method, by its place among the methods; every figure uses it."""
    return COLOURS[place % len(COLOURS)]


def names_of(methods: Sequence[Method]) -> list[str]:
    """Return the paper's titles of its methods, and short names of the others."""
    short = short_names([method.title for method in methods])
    papers = [method.published is not None and method.title.startswith(method.published.title) for method in methods]
    return [m.title if is_papers else short[m.title] for m, is_papers in zip(methods, papers, strict=True)]


def _name_methods(part: Any, methods: Sequence[Method], marks: Mapping[str, Any] | None = None, **where: Any) -> None:
    """Name the colours of the methods, and any further marks, in one legend beside the panels of a figure."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour_of(place), lw=1.8) for place in range(len(methods))]
    names = names_of(methods)
    for name, style in (marks or {}).items():
        handles.append(Line2D([], [], **style))
        names.append(name)
    part.legend(handles, names, ncols=min(len(names), 5), **where)


# Figure 2: one trial of each task: the scene at peak force, and what the logger wrote.

STREAMS = (("Force [N]", 1.0), ("Wrist moved [mm]", 5.0), ("Tissue pressed in [mm]", 1.0))
"""Title, and the least end of the axis."""


def draw_traces(figure: Figure, methods: Sequence[Method], recordings: Sequence[Sequence[Recording]]) -> None:
    """Draw a row for each task; ``recordings``: for each method, one trial of each task, or none."""
    by_task: dict[str, list[tuple[int, Recording]]] = {}
    for place, of_method in enumerate(recordings):
        for recording in of_method:
            by_task.setdefault(recording.header.spec.task_id, []).append((place, recording))
    rows = len(by_task)
    figure.set_size_inches(7.2, 0.75 + 0.85 * rows)
    grid: Any = figure.subplots(rows, 4, squeeze=False, width_ratios=(1.1, 1.5, 1.5, 1.5))
    ends = np.array([0.1, *(least for _, least in STREAMS)])
    for axes, (task_id, drawn) in zip(grid, sorted(by_task.items()), strict=True):
        task = drawn[0][1].header.spec.protocol.task(task_id)
        _scene(axes[0], drawn[0][1], f"{task.id} {task.name}")
        for place, recording in drawn:
            for number, (time_s, values) in enumerate(streams(recording), start=1):
                axes[number].plot(time_s, values, color=colour_of(place), lw=0.9)
                ends[0] = max(ends[0], np.max(time_s, initial=0.0))
                ends[number] = max(ends[number], 1.08 * np.max(values, initial=0.0))
    # One scale for each column, so that rows can be compared and what did not move looks still.
    for row, axes in enumerate(grid[:, 1:]):
        for number, panel in enumerate(axes, start=1):
            panel.set(xlim=(0, ends[0]), ylim=(0, ends[number]))
            panel.locator_params(axis="y", nbins=3)
            panel.tick_params(labelbottom=row == rows - 1)
    for panel, (title, _) in zip(grid[0][1:], STREAMS, strict=True):
        panel.set_title(title)
    for panel in grid[-1][1:]:
        panel.set_xlabel("time [s]")
    _name_methods(figure, methods, loc="outside lower center")


def streams(recording: Recording) -> list[tuple[Any, Any]]:
    """(time [s], values) of the force on the target's segment [N], of the wrist's horizontal shift [mm] and of the
    target's indentation [mm]."""
    header, spec = recording.header, recording.header.spec
    region = spec.protocol.task(spec.task_id).region
    segment = header.segments.index(REGIONS[region].segment)
    time_s = recording["scorer/time_s"]
    force = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][:, segment], axis=1)
    shift = (recording["scorer/wrist_in_world"] - recording["scorer/wrist_settled_in_world"])[:, :2]
    indented = recording["scorer/indentation_m"][:, region_column(recording)]
    return [
        (time_s, force),
        (time_s, 1000 * np.linalg.norm(shift, axis=1)),
        (recording["scorer/period_time_s"], 1000 * indented),
    ]


def _scene(panel: Any, recording: Recording, title: str) -> None:
    panel.set_axis_off()
    picture = next(
        (recording.arrays[p] for p in ("report/peak_rgb", "report/snapshot_rgb") if p in recording.arrays), None
    )
    if picture is None:
        panel.text(0.5, 0.5, f"{title}\n(no picture)", ha="center", va="center", transform=panel.transAxes, color=GREY)
        return
    panel.imshow(picture[::2, ::2], interpolation="none")
    panel.set_title(title, fontsize=7.5)


# Figure 3: force against indentation in the trials, for each soft region.

BIN_MM, FEWEST = 0.5, 5
"""Width of a bin of the median, and control periods that it needs."""


def draw_indentation(figure: Figure, methods: Sequence[Method], recordings: Sequence[Sequence[Recording]]) -> None:
    """Draw the points of every trial in the colour of its method, and a line through the method's medians."""
    by_region: dict[str, dict[int, list[tuple[Any, Any]]]] = {}
    for place, of_method in enumerate(recordings):
        for recording in of_method:
            spec = recording.header.spec
            depth, force = pairs(recording)
            if len(depth):
                of_region = by_region.setdefault(spec.protocol.task(spec.task_id).region, {})
                of_region.setdefault(place, []).append((depth, force))
    figure.set_size_inches(7.2, 2.5)
    panels: Any = figure.subplots(1, max(len(by_region), 1), squeeze=False)[0]
    for index, (panel, (region, of_region)) in enumerate(zip(panels, by_region.items(), strict=False)):
        for place, curves in of_region.items():
            depth, force = (np.concatenate(values) for values in zip(*curves, strict=True))
            panel.plot(depth, force, ".", color=colour_of(place), ms=2.5, alpha=0.35, mew=0)
            panel.plot(*binned(depth, force), color=colour_of(place), lw=1.4)
        trials = counted(sum(map(len, of_region.values())), "trial")
        letter(panel, index, f"{region.replace('_', ' ').capitalize()}, {trials}")
        panel.set(xlabel="indentation [mm]", xlim=(0, None), ylim=(0, None))
    panels[0].set_ylabel("force on the segment [N]")
    marks = {
        "one control period": {"color": GREY, "ls": "", "marker": ".", "mew": 0},
        f"median in steps of {BIN_MM:g} mm": {"color": GREY, "lw": 1.4},
    }
    _name_methods(figure, methods, marks, loc="outside lower center")


def pairs(recording: Recording) -> tuple[Any, Any]:
    """(indentation [mm], force [N]) at each control period in which the target is pressed in."""
    (time_s, force), _, (period_s, depth) = streams(recording)
    if not len(time_s):
        return np.zeros(0), np.zeros(0)
    at = np.clip(np.searchsorted(time_s, period_s) - 1, 0, len(force) - 1)
    pressed = (depth > 0.1) & (force[at] > 0)
    return depth[pressed], force[at][pressed]


def binned(depth: Any, force: Any) -> tuple[Any, Any]:
    """Return medians of the force in bins of the depth that hold enough of it."""
    number = np.floor(depth / BIN_MM).astype(int)
    kept = [k for k in range(number.max(initial=-1) + 1) if (number == k).sum() >= FEWEST]
    return np.array([(k + 0.5) * BIN_MM for k in kept]), np.array([np.median(force[number == k]) for k in kept])


# Figure 4: what the methods did, every trial as a point, and why they failed.

MODES = {
    "insufficient_progress": "#E69F00", "no_target_contact": "#56B4E9", "off_target_contact": "#0072B2",
    "lost_contact": "#CC79A7", "wrong_share": "#F0E442", "safety_truncation": "#D55E00", "time_limit": "#999999",
    "process_failure": "#000000", "outside_band": "#8C564B", "joint_beyond_range": "#009E73", "not_by_tool": "#7A4FBF",
}  # fmt: skip
"""Failure mode -> its colour."""
LINES = ("-", "--", ":", "-.")
"""Line styles of the tasks over one region."""
NEAR_MM = 250.0
"""Tool paths are drawn where they are within this distance of the region's middle, along it and across it."""


def mean_force(score: TrialScore) -> float | None:
    """Impulse over the time in contact [N]."""
    return score.impulse_ns / score.contact_s if score.valid_contact and score.contact_s else None


def within_run_sd(score: TrialScore) -> float | None:
    """C5 [N]."""
    return score.c5_force_sd_n if mean_force(score) is not None else None


@dataclass(frozen=True, kw_only=True)
class Panel:
    title: str
    action: str = ""
    """Empty: all."""
    value: Callable[[TrialScore], float | None]
    """Return the value of a trial; None: the trial has none and is no point."""
    spread: Callable[[TrialScore], float | None] = lambda score: None
    """Half the length of a thin bar through the point."""
    printed: tuple[str, float] | None = None
    """Score of which the paper prints a median, and the factor to the panel's unit."""


PAPER_MARK: dict[str, Any] = {"ls": "", "marker": "D", "mfc": "white", "mec": "black", "ms": 4, "mew": 0.9}
"""A median that the paper prints."""
MEDIAN = {"color": "black", "lw": 1.3}

PANELS = (
    Panel(title="Touch: force,\nmean and SD [N]", action="touch", value=mean_force, spread=within_run_sd),
    Panel(title="Scrub: force,\nmean and SD [N]", action="scrub", value=mean_force, spread=within_run_sd),
    Panel(title="Scrub: stroke [mm]", action="scrub", value=lambda s: 1000 * s.stroke_m),
    Panel(title="Push: wrist\nmoved [mm]", action="push", value=lambda s: 1000 * s.wrist_displacement_m),
    Panel(title="Push: joint-limit\nmargin, C2 [mrad]", action="push",
          value=lambda s: None if s.c2_joint_margin_rad is None else 1000 * s.c2_joint_margin_rad,
          printed=("C2", 1000.0)),
    Panel(title="Push: force,\nmean and SD [N]", action="push", value=mean_force, spread=within_run_sd),
    Panel(title="Motion activity, C4", value=lambda s: s.c4_motion_activity, printed=("C4", 1.0)),
)  # fmt: skip


def draw_outcomes(figure: Figure, methods: Sequence[Method], paths: Sequence[Sequence[Recording]]) -> None:
    """``paths``: for each method, the recordings whose tool paths are drawn; none where there are no recordings."""
    by_region = _by_region(paths)
    every = [score for method in methods for score in method.scores]
    done = {"", *(score.action for score in every)}
    shown = [panel for panel in PANELS if panel.action in done]
    rows, failed = -(-(len(shown) + 1) // 4), any(score.failure_mode for score in every)
    heights = [0.3 + 1.7 * rows, *([2.2] if by_region else []), *([1.1 + 0.4 * len(methods)] if failed else [])]
    figure.set_size_inches(7.2, sum(heights))
    parts: Any = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    upper: Any = parts[0].subplots(rows, 4, squeeze=False).flat
    for index, (panel, what) in enumerate(zip(upper, shown, strict=False)):
        letter(panel, index, what.title)
        _dots(panel, methods, what)
    last = len(shown)
    letter(upper[last], last, "Trials with valid\ncontact [%]")
    _valid(upper[last], methods)
    for empty in upper[last + 1 :]:
        empty.set_axis_off()
    printed = any(method.published for method in methods) and any(panel.printed for panel in shown)
    marks = {"median": MEDIAN, **({"median in the paper": PAPER_MARK} if printed else {})}
    _name_methods(parts[0], methods, marks, loc="outside upper center")
    if by_region:
        for index, (panel, (region, drawn)) in enumerate(
            zip(parts[1].subplots(1, len(by_region), squeeze=False)[0], by_region.items(), strict=True)
        ):
            letter(panel, last + 1 + index, f"{region.replace('_', ' ').capitalize()}: tool path [mm]")
            _paths(panel, methods, drawn)
    if failed:
        failures = parts[-1].subplots()
        letter(failures, last + 1 + len(by_region), "Why trials failed")
        _failures(failures, methods)


def _dots(panel: Any, methods: Sequence[Method], what: Panel) -> None:
    """Every trial is a point, and the median a line. The spread to the side is fixed by the order of the trials."""
    found: list[float] = []
    for place, method in enumerate(methods):
        of_action = [(what.value(s), what.spread(s)) for s in method.scores if what.action in ("", s.action)]
        valid = [(value, spread or 0.0) for value, spread in of_action if value is not None]
        values, spreads = np.array(valid, float).reshape(-1, 2).T
        found += [*(values + spreads), *np.maximum(values - spreads, np.minimum(values, 0))]
        side = place + 0.28 * (((np.arange(len(values)) * 0.618034) % 1) * 2 - 1)
        size, colour = 2.2 if len(values) > 30 else 3.5, colour_of(place)
        if spreads.any():
            panel.vlines(side, values - spreads, values + spreads, color=colour, lw=0.5, alpha=0.35)
        panel.plot(side, values, "o", ms=size, color=colour, alpha=0.7, mew=0)
        if len(values):
            panel.plot([place - 0.36, place + 0.36], [np.median(values)] * 2, **MEDIAN)
        else:
            panel.text(place, 0.5, "none", ha="center", transform=panel.get_xaxis_transform(), color=GREY, fontsize=7)
        if what.printed and method.published:
            score, factor = what.printed
            found.append(factor * method.published.medians[score])
            panel.plot([place], found[-1:], **PAPER_MARK)
    if min(found, default=0.0) >= 0:
        # Sizes are read from zero; only margins can be negative.
        panel.set_ylim(0, 1.08 * max(found, default=0.0) or 1.0)
    _method_ticks(panel, methods)


def _valid(panel: Any, methods: Sequence[Method]) -> None:
    """Trials with scoreable contact, which need not be successes."""
    for place, method in enumerate(methods):
        k, n = sum(score.valid_contact for score in method.scores), len(method.scores)
        panel.bar(place, 100 * k / n, width=0.6, color=colour_of(place), alpha=0.85)
        panel.text(place, 100 * k / n + 2, f"{k}/{n}", ha="center", va="bottom", fontsize=6.5)
    panel.set_ylim(0, 118)
    panel.set_yticks((0, 50, 100))
    _method_ticks(panel, methods)


def _method_ticks(panel: Any, methods: Sequence[Method]) -> None:
    """Give each method a place; its colour, which the legend names, says which one it is."""
    panel.set_xlim(-0.6, len(methods) - 0.4)
    panel.set_xticks([])


def _by_region(paths: Sequence[Sequence[Recording]]) -> dict[str, list[tuple[int, Recording]]]:
    """Region -> the recordings of its tasks that have a path, each with the place of its method."""
    found: dict[str, list[tuple[int, Recording]]] = {}
    for place, recordings in enumerate(paths):
        for recording in recordings:
            spec = recording.header.spec
            if len(recording["scorer/region_pose_in_world"]):
                found.setdefault(spec.protocol.task(spec.task_id).region, []).append((place, recording))
    return found


def _paths(panel: Any, methods: Sequence[Method], shown: Sequence[tuple[int, Recording]]) -> None:
    """The tool point above the region at rest, along it and across it, and the region's outline from above: a line
    style for each task, named below the panel."""
    tasks = sorted({recording.header.spec.task_id for _, recording in shown})
    names = names_of(methods)
    far: list[str] = []
    for place, recording in shown:
        task = recording.header.spec.task_id
        along, across = _over_region(recording)
        near = np.maximum(np.abs(along), np.abs(across)) <= NEAR_MM
        along, across = np.where(near, along, np.nan), np.where(near, across, np.nan)
        far += [] if near.any() else [f"{names[place]}, {task}"]
        panel.plot(along, across, color=colour_of(place), lw=0.8, alpha=0.85, ls=_style(tasks, task))
    length, radius, _ = shown[0][1]["scorer/region_size_m"][region_column(shown[0][1])].tolist()
    x, y = np.array([-1, 1, 1, -1, -1]) * 500 * length, np.array([-1, -1, 1, 1, -1]) * 1000 * radius
    panel.plot(x, y, color="black", lw=0.9, label="region")
    panel.plot([0], [0], "k+", ms=6)
    for task in tasks:
        panel.plot([], [], color=GREY, lw=0.8, ls=_style(tasks, task), label=task)
    if far:
        box = {"fc": "white", "ec": "none", "pad": 0.5}
        text = "not near: " + "; ".join(far)
        panel.text(0.02, 0.98, text, va="top", transform=panel.transAxes, fontsize=5.5, bbox=box)
    panel.set(xlabel="along the region", ylabel="across it")
    panel.set_aspect("equal", adjustable="datalim")
    panel.locator_params(axis="x", nbins=5, prune="both")  # a number at the end would stand half outside the figure
    panel.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.32), ncols=len(tasks) + 1, fontsize=6.5, handlelength=1.6,
        columnspacing=1, borderaxespad=0,
    )  # fmt: skip


def _style(tasks: Sequence[str], task: str) -> str:
    return LINES[tasks.index(task) % len(LINES)]


def _over_region(recording: Recording) -> tuple[Any, Any]:
    pose = region_poses(recording)[0]
    origin, (w, x, y, z) = pose[:3], pose[3:]
    ahead = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    ahead /= np.linalg.norm(ahead) or 1.0
    flat = 1000 * (recording["scorer/pose_tcp_in_world"][::25, :2] - origin[:2])
    return flat @ ahead, flat @ np.array([-ahead[1], ahead[0]])


def _failures(panel: Any, methods: Sequence[Method]) -> None:
    counts = [Counter(s.failure_mode for s in m.scores if s.failure_mode) for m in methods]
    most = max(sum(count.values()) for count in counts)
    left = [0] * len(counts)
    for mode, colour in MODES.items():
        # The name is on one bar of each mode.
        label: str | None = mode.replace("_", " ")
        for place, k in enumerate(count[mode] for count in counts):
            if k:
                panel.barh(place, k, left=left[place], color=colour, height=0.5, label=label)
                _number(panel, left[place] + k / 2, place, k, colour, wide=k >= 0.03 * most)
                left[place], label = left[place] + k, None
    labels = [
        f"{name}\n({sum(count.values())} of {len(method.scores)})"
        for name, count, method in zip(names_of(methods), counts, methods, strict=True)
    ]
    panel.set_yticks(range(len(methods)), labels)
    panel.set(xlabel="trials that are not region-correct", ylim=(len(methods) - 0.5, -0.65))
    panel.locator_params(axis="x", integer=True)
    panel.grid(visible=False, axis="y")
    panel.legend(loc="upper left", bbox_to_anchor=(0, -0.3), ncols=5, handlelength=1, columnspacing=1, borderaxespad=0)


def _number(panel: Any, x: float, place: int, count: int, colour: str, *, wide: bool) -> None:
    """Write the count into the bar, or above a bar that is too narrow for it."""
    ink = "white" if wide and colour in ("#0072B2", "#D55E00", "#000000") else "black"
    y, align = (place, "center") if wide else (place - 0.27, "bottom")
    panel.text(x, y, str(count), ha="center", va=align, color=ink, fontsize=7 if wide else 6)


# Figure 1: how data flows through the benchmark, and which of it no policy receives.

HEIGHT = 1.35
BOXES = {
    "cameras": (0.0, 3.0, 2.5, "Instruction, images", "RGB, depth, encoders"),
    "vision": (3.2, 3.0, 2.5, "Vision models", "points, masks,\nlandmarks"),
    "policy": (6.4, 3.0, 2.5, "Policy", "a process of its own"),
    "robot": (9.6, 3.0, 2.5, "Robot arm", "impedance control"),
    "person": (9.6, 0.0, 2.5, "Person", "soft tissue,\npassive joints"),
    "log": (6.4, 0.0, 2.5, "Log", "forces and joints\nat every step"),
    "scores": (3.2, 0.0, 2.5, "Scores", "C1 force, C2 joints,\nC4 motion, C5 steadiness"),
    "rates": (0.0, 0.0, 2.5, "Success (C3)", "region-correct,\nsafety-gated"),
}
"""Name -> left and lower edge, width, title, text."""
SEEN = (("cameras", "vision"), ("vision", "policy"), ("policy", "robot"))
HIDDEN = (("person", "log"), ("log", "scores"), ("scores", "rates"))


def draw_overview(figure: Figure) -> None:
    figure.set_size_inches(7.2, 3.0)
    axes = figure.subplots()
    axes.set(xlim=(-0.15, 12.25), ylim=(-0.55, 5.0))
    axes.set_axis_off()
    for name, (x, y, width, title, text) in BOXES.items():
        colour = COLOURS[0] if y > 0 else COLOURS[1]
        _box(axes, x, y, width, title, text, colour=GREY if name == "person" else colour)
    for names, colour in ((SEEN, COLOURS[0]), (HIDDEN, COLOURS[1])):
        for a, b in names:
            _arrow(axes, _side(a, b), _side(b, a), colour)
    x, width = BOXES["robot"][0], BOXES["robot"][2]
    _arrow(axes, (x + 0.35 * width, 3.0), (x + 0.35 * width, HEIGHT), GREY)
    _arrow(axes, (x + 0.65 * width, HEIGHT), (x + 0.65 * width, 3.0), GREY)
    axes.text(x + 0.28 * width, 2.18, "contact", ha="right", va="center", color=GREY)
    axes.text(x + 0.72 * width, 2.18, "reaction", ha="left", va="center", color=GREY)
    axes.plot([9.9, 9.9, 1.25, 1.25], [HEIGHT, 1.75, 1.75, 2.85], color=GREY, lw=0.9, ls=(0, (4, 3)))
    _arrow(axes, (1.25, 2.8), (1.25, 3.0), GREY)
    axes.text(5.1, 1.87, "the next images", ha="center", va="bottom", color=GREY)
    axes.text(0, 4.62, "What a policy sees", color=COLOURS[0], weight="bold", va="bottom")
    axes.text(0, -0.48, "What the scorer alone sees", color=COLOURS[1], weight="bold", va="bottom")


def _box(axes: Axes, x: float, y: float, width: float, title: str, text: str, *, colour: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    shape = "round,pad=0,rounding_size=0.12"
    axes.add_patch(FancyBboxPatch((x, y), width, HEIGHT, boxstyle=shape, fc="white", ec=colour, lw=1.2))
    axes.text(x + width / 2, y + HEIGHT - 0.16, title, ha="center", va="top", weight="bold", fontsize=7.5)
    axes.text(x + width / 2, y + 0.45, text, ha="center", va="center", fontsize=6.8, color=GREY, linespacing=1.15)


def _side(name: str, other: str) -> tuple[float, float]:
    """Return the middle of the edge that looks at the other box."""
    x, y, width = BOXES[name][:3]
    return (x + width if BOXES[other][0] > x else x), y + HEIGHT / 2


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 1, "shrinkB": 1}
    axes.annotate("", end, start, arrowprops=arrow)
