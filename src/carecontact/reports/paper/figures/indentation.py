"""Figure 3: force against indentation in the trials, and the law of the tissue, for each soft region."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carecontact.errors import counted
from carecontact.reports.paper.figures.style import COLOURS, letter
from carecontact.reports.paper.figures.traces import streams

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carecontact.recording.schema import Recording

BIN_MM, FEWEST = 0.5, 5
"""Width of a bin of the median, and control periods that it needs."""


def draw(figure: Figure, recordings: Sequence[Recording]) -> None:
    by_region: dict[str, list[tuple[Any, Any]]] = {}
    for recording in recordings:
        spec = recording.header.spec
        pressed = pairs(recording)
        if len(pressed[0]):
            by_region.setdefault(spec.protocol.task(spec.task_id).region, []).append(pressed)
    figure.set_size_inches(7.2, 2.5)
    panels: Any = figure.subplots(1, max(len(by_region), 1), squeeze=False)[0]
    for index, (panel, (region, curves)) in enumerate(zip(panels, by_region.items(), strict=False)):
        for depth, force in curves:
            panel.plot(depth, force, ".", color="0.65", ms=1.2)
        x, y = binned(np.concatenate([c[0] for c in curves]), np.concatenate([c[1] for c in curves]))
        panel.plot(x, y, color=COLOURS[0], lw=1.6)
        letter(panel, index, f"{region.replace('_', ' ').capitalize()}, {counted(len(curves), 'trial')}")
        panel.set(xlabel="indentation [mm]", xlim=(0, None), ylim=(0, None))
    panels[0].set_ylabel("force on the segment [N]")
    from matplotlib.lines import Line2D

    kinds = [Line2D([], [], ls="", marker=".", color="0.65"), Line2D([], [], color=COLOURS[0], lw=1.6)]
    panels[0].legend(kinds, ["control period of a trial", f"median in steps of {BIN_MM:g} mm"], loc="upper left")


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
