"""One figure: force over depth, exponent over the radius, and the dimple, of both answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from carecontact.validation.fem.answer import Answer
from carecontact.validation.fem.cases import DEPTHS_M
from carecontact.validation.fem.compare import Comparison
from carecontact.validation.fem.simulated import RINGS_M
from carecontact.validation.result import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FEM, PLAIN, HERE = "#56B4E9", "#009E73", "#D55E00"


def draw(comparisons: list[Comparison], figure: Figure) -> None:
    """One row for each region."""
    figure.set_size_inches(7.6, 2.3 * len(comparisons))
    grid = figure.subplots(len(comparisons), 4, squeeze=False)
    for row, done in zip(grid, comparisons, strict=True):
        depth = np.linspace(0.0002, DEPTHS_M[-1], 40)
        name = done.case.main()
        _panel(row[0], done, 1000 * depth, lambda a, d=depth, n=name: a.curves[n].at(d))
        reference = done.case.reference
        shown = reference.depth_m <= 0.0045
        row[0].plot(1000 * reference.depth_m[shown], reference.force_n[shown], "k:", lw=1, label="people, middle")
        row[0].set(title=f"{done.case.region}, {name}", xlabel="depth [mm]", ylabel="force [N]", ylim=(0, None))
        for axes, word in zip(row[1:3], ("ball", "disc"), strict=True):
            _panel(axes, done, 1000 * DEPTHS_M, lambda a, w=word: a.exponents(w))
            axes.set(title=f"{word}s", xlabel="depth [mm]", ylabel="exponent over radius")
        _panel(row[3], done, 1000 * RINGS_M, lambda a: -a.dimple(RINGS_M))
        row[3].set(title="dimple", xlabel="from the axis [mm]", ylabel="height / travel")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def _panel(axes: Axes, done: Comparison, x: Array, of: Callable[[Answer], Array]) -> None:
    skins = np.array([of(answer) for answer in done.skins])
    axes.fill_between(x, skins.min(0), skins.max(0), color=FEM, alpha=0.35, lw=0, label="finite elements, skins")
    axes.plot(x, skins[0], color="#0072B2", label="middle skin")
    axes.plot(x, of(done.plain), "--", color=PLAIN, label="no skin")
    axes.plot(x, of(done.simulated), color=HERE, label="simulator")
