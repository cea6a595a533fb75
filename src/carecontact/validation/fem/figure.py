"""One figure of both answers: force over depth, exponent of the radius, dimple, and force over the distance along."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from carecontact.validation.fem.answer import Answer
from carecontact.validation.fem.cases import DEPTHS_M, RINGS_M
from carecontact.validation.fem.compare import Comparison
from carecontact.validation.result import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FEM, MIDDLE, PLAIN, HERE = "#56B4E9", "#0072B2", "#009E73", "#D55E00"
TITLES = ("force over depth", "growth with balls' size", "growth with discs' size", "dimple", "gliding, 4 mm deep")
SHOWN_WAYS_M = np.linspace(0.0, 0.005, 51)


def draw(comparisons: list[Comparison], figure: Figure) -> None:
    """Draw one row of panels for each region."""
    figure.set_size_inches(9.6, 2.05 * len(comparisons) + 0.5)
    grid = figure.subplots(len(comparisons), len(TITLES), squeeze=False, sharex="col")
    for axes, title in zip(grid[0], TITLES, strict=True):
        axes.set_title(title)
    for row, done in zip(grid, comparisons, strict=True):
        _row(row, done)
    for axes, label in zip(grid[-1], ("depth [mm]",) * 3 + ("from the axis [mm]", "way along [mm]"), strict=True):
        axes.set_xlabel(label)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def _row(row: list[Axes], done: Comparison) -> None:
    case, name = done.case, done.case.main.name
    depth = np.linspace(0.0002, DEPTHS_M[-1], 40)
    _panel(row[0], done, 1000 * depth, lambda a: a.curves[name].at(depth))
    shown = case.reference.depth_m <= 0.0045
    row[0].plot(
        1000 * case.reference.depth_m[shown], case.reference.force_n[shown], "k:", lw=1.2, label="people, middle"
    )
    row[0].set(ylabel="force [N]", ylim=(0, None), xlim=(0, 4.5))
    row[0].annotate(
        f"{case.region.replace('_', ' ')}\n{name}", (0.05, 0.95), xycoords="axes fraction", va="top", weight="bold"
    )
    for axes, word in zip(row[1:3], ("ball", "disc"), strict=True):
        _panel(axes, done, 1000 * DEPTHS_M, lambda a, w=word: a.exponents(case, w))
        axes.set(ylabel="exponent over radius", xlim=(0, 4.2))
    _panel(row[3], done, 1000 * RINGS_M, lambda a: -a.dimple)
    row[3].set(ylabel="height / travel", xlim=(0, 31))
    _panel(row[4], done, 1000 * SHOWN_WAYS_M, lambda a: a.drags[name].at(SHOWN_WAYS_M))
    row[4].set(ylabel="force along [N]", ylim=(0, None), xlim=(0, 5))


def _panel(axes: Axes, done: Comparison, x: Array, of: Callable[[Answer], Array]) -> None:
    skins = np.array([of(answer) for answer in done.skins])
    axes.fill_between(x, skins.min(0), skins.max(0), color=FEM, alpha=0.35, lw=0, label="finite elements, all skins")
    axes.plot(x, skins[0], color=MIDDLE, label="middle skin")
    axes.plot(x, of(done.plain), "--", color=PLAIN, label="no skin")
    axes.plot(x, of(done.simulated), color=HERE, label="simulator")
