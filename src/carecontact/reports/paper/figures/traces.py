"""Figure 2: one trial of each task: the scene at peak force, and what the logger wrote."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carecontact.regions import REGIONS
from carecontact.reports.paper.figures.style import COLOURS, GREY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carecontact.recording.schema import Recording

STREAMS = ("Force [N]", "Wrist moved [mm]", "Tissue pressed in [mm]")


def draw(figure: Figure, recordings: Sequence[Recording]) -> None:
    """``recordings``: one trial of each task, in order."""
    rows = len(recordings)
    figure.set_size_inches(7.2, 0.35 + 1.05 * rows)
    grid: Any = figure.subplots(rows, 4, squeeze=False, width_ratios=(1.25, 1.5, 1.5, 1.5))
    for axes, recording in zip(grid, recordings, strict=True):
        task = recording.header.spec.protocol.task(recording.header.spec.task_id)
        _scene(axes[0], recording, f"{task.id} {task.name}")
        for number, (panel, (time_s, values)) in enumerate(zip(axes[1:], streams(recording), strict=True)):
            panel.plot(time_s, values, color=COLOURS[number], lw=0.9)
            panel.set_xlim(0, max(time_s[-1] if len(time_s) else 0, 0.1))
            panel.set_ylim(bottom=0, top=max(1.1 * float(np.max(values, initial=0.0)), 1.0))
            panel.locator_params(axis="y", nbins=3)
    for panel, title in zip(grid[0][1:], STREAMS, strict=True):
        panel.set_title(title)
    for panel in grid[-1][1:]:
        panel.set_xlabel("time [s]")


def streams(recording: Recording) -> list[tuple[Any, Any]]:
    """(time [s], values) of the force on the target's segment [N], of the wrist's horizontal shift [mm] and of the
    target's indentation [mm]."""
    header, spec = recording.header, recording.header.spec
    region = spec.protocol.task(spec.task_id).region
    segment = header.segments.index(REGIONS[region].segment)
    time_s = recording["scorer/time_s"]
    force = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][:, segment], axis=1)
    shift = (recording["scorer/wrist_in_world"] - recording["scorer/wrist_settled_in_world"])[:, :2]
    indented = recording["scorer/indentation_m"][:, header.regions.index(region)]
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
