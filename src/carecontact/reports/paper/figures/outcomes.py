"""Figure 4: what the methods did, every trial as a point, and why they failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carecontact.reports.paper.figures.style import COLOURS, GREY, letter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carecontact.recording.schema import Recording
    from carecontact.reports.paper.method import Method
    from carecontact.scoring.result import TrialScore

MODES = (
    "insufficient_progress", "no_target_contact", "off_target_contact", "lost_contact", "wrong_share",
    "safety_truncation", "time_limit", "process_failure", "outside_band", "joint_beyond_range",
)  # fmt: skip
NEAR_MM = 250.0
"""Tool paths are drawn where they are within this distance of the region's middle, along it and across it."""
MODE_COLOURS = (
    "#E69F00",
    "#56B4E9",
    "#0072B2",
    "#CC79A7",
    "#F0E442",
    "#D55E00",
    "#999999",
    "#000000",
    "#8C564B",
    "#009E73",
)


def mean_force(score: TrialScore) -> float | None:
    """Impulse over the time in contact [N]."""
    return score.impulse_ns / score.contact_s if score.valid_contact and score.contact_s else None


PANELS: tuple[tuple[str, str, Callable[[TrialScore], float | None]], ...] = (
    ("Touch: mean force [N]", "touch", mean_force),
    ("Scrub: mean force [N]", "scrub", mean_force),
    ("Scrub: stroke [mm]", "scrub", lambda s: 1000 * s.stroke_m),
    ("Push: wrist moved [mm]", "push", lambda s: 1000 * s.wrist_displacement_m),
    ("Push: C2 [mrad]", "push", lambda s: None if s.c2_joint_margin_rad is None else 1000 * s.c2_joint_margin_rad),
    ("Motion activity, C4", "", lambda s: s.c4_motion_activity),
)
"""Title, action ("" for all), and the value of a trial."""


def draw(figure: Figure, methods: Sequence[Method], paths: Sequence[Sequence[Recording]]) -> None:
    """``paths``: for each method, the recordings whose tool paths are drawn; none where there are no recordings."""
    figure.set_size_inches(7.2, 5.6)
    halves: Any = figure.subfigures(2, 1, height_ratios=(2, 1.1))
    upper, lower = halves
    for index, (panel, (title, action, value)) in enumerate(zip(upper.subplots(2, 3).flat, PANELS, strict=True)):
        letter(panel, index, title)
        _dots(panel, methods, action, value)
    tool, failures = lower.subplots(1, 2, width_ratios=(1, 1.9))
    letter(tool, 6, "Tool paths over the region [mm]")
    _paths(tool, methods, paths)
    letter(failures, 7, "Why trials failed")
    _failures(failures, methods)


def _dots(panel: Any, methods: Sequence[Method], action: str, value: Callable[[TrialScore], float | None]) -> None:
    """Every trial is a point, and the median a line. The spread to the side is fixed by the order of the trials."""
    found: list[float] = []
    for place, method in enumerate(methods):
        of_action = [value(s) for s in method.scores if action in ("", s.action)]
        values = np.array([v for v in of_action if v is not None], float)
        found += values.tolist()
        side = 0.28 * (((np.arange(len(values)) * 0.618034) % 1) * 2 - 1)
        size = 2.2 if len(values) > 30 else 3.5
        panel.plot(place + side, values, "o", ms=size, color=COLOURS[place % len(COLOURS)], alpha=0.7, mew=0)
        if len(values):
            panel.plot([place - 0.36, place + 0.36], [np.median(values)] * 2, color="black", lw=1.3)
        else:
            panel.text(place, 0.5, "none", ha="center", transform=panel.get_xaxis_transform(), color=GREY, fontsize=7)
    if min(found, default=0.0) >= 0:
        # Sizes are read from zero; only margins can be negative.
        panel.set_ylim(0, 1.08 * max(found, default=0.0) or 1.0)
    _method_ticks(panel, methods)


def _method_ticks(panel: Any, methods: Sequence[Method]) -> None:
    panel.set_xlim(-0.6, len(methods) - 0.4)
    panel.set_xticks(range(len(methods)), [_short(m.title).replace(" ", "\n") for m in methods])
    panel.grid(visible=False, axis="x")


def _short(title: str) -> str:
    return title if len(title) <= 14 else f"{title[:13]}…"


def _paths(panel: Any, methods: Sequence[Method], paths: Sequence[Sequence[Recording]]) -> None:
    """The tool point above the named region at rest, along it and across it; a cross marks the region's middle."""
    drawn = False
    for place, recordings in enumerate(paths):
        for recording in recordings:
            along, across = _over_region(recording)
            near = np.maximum(np.abs(along), np.abs(across)) <= NEAR_MM
            along, across = np.where(near, along, np.nan), np.where(near, across, np.nan)
            drawn |= bool(near.any())
            panel.plot(along, across, color=COLOURS[place % len(COLOURS)], lw=0.7, alpha=0.8)
    if not drawn:
        panel.set_axis_off()
        panel.text(0.5, 0.5, "no recorded path", ha="center", va="center", transform=panel.transAxes, color=GREY)
        return
    panel.plot([0], [0], "k+", ms=7)
    panel.set(xlabel="along the region", ylabel="across it")
    panel.set_aspect("equal", adjustable="datalim")


def _over_region(recording: Recording) -> tuple[Any, Any]:
    header = recording.header
    region = header.regions.index(header.spec.protocol.task(header.spec.task_id).region)
    poses = recording["scorer/region_pose_in_world"]
    if not len(poses):
        return np.zeros(0), np.zeros(0)
    origin, (w, x, y, z) = poses[0, region, :3].astype(float), poses[0, region, 3:].astype(float)
    ahead = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)])
    ahead /= np.linalg.norm(ahead) or 1.0
    flat = 1000 * (recording["scorer/pose_tcp_in_world"][::25, :2] - origin[:2])
    return flat @ ahead, flat @ np.array([-ahead[1], ahead[0]])


def _failures(panel: Any, methods: Sequence[Method]) -> None:
    counts = [Counter(s.failure_mode for s in m.scores if s.failure_mode) for m in methods]
    left = np.zeros(len(methods))
    for mode, colour in zip(MODES, MODE_COLOURS, strict=True):
        widths = np.array([count[mode] for count in counts], float)
        if not widths.any():
            continue
        panel.barh(range(len(methods)), widths, left=left, color=colour, height=0.55, label=mode.replace("_", " "))
        for place in range(len(methods)):
            if widths[place] >= 0.06 * max(sum(c.values()) for c in counts):
                ink = "white" if colour in ("#0072B2", "#D55E00", "#000000") else "black"
                x = left[place] + widths[place] / 2
                panel.text(x, place, f"{widths[place]:.0f}", ha="center", va="center", color=ink, fontsize=7)
        left += widths
    if not left.any():
        panel.set_axis_off()
        told = "every trial was region-correct"
        panel.text(0.5, 0.5, told, ha="center", va="center", transform=panel.transAxes, color=GREY)
        return
    names = [f"{_short(m.title)}\n({sum(c.values())} of {len(m.scores)})" for m, c in zip(methods, counts, strict=True)]
    panel.set_yticks(range(len(methods)), names)
    panel.set(xlabel="trials that are not region-correct", ylim=(len(methods) - 0.4, -0.9 - 0.4 * len(methods)))
    panel.grid(visible=False, axis="y")
    panel.legend(loc="upper left", ncols=3, bbox_to_anchor=(0, 1.02), handlelength=1, columnspacing=1)
