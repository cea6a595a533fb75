"""One style for every figure, drawn without a display."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.plotting import plain_figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's palette: colour-blind readers can distinguish its colours, also in print.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLE = {
    "font.size": 8, "axes.titlesize": 9, "axes.labelsize": 8, "legend.fontsize": 7, "xtick.labelsize": 7,
    "ytick.labelsize": 7, "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.7,
    "lines.linewidth": 1.3, "legend.frameon": False, "savefig.dpi": 200, "figure.constrained_layout.use": True,
    "axes.grid": True, "grid.color": "0.9", "grid.linewidth": 0.5,
}  # fmt: skip


def draw_figure(draw: Callable[[Figure], None], path: Path) -> None:
    """Call ``draw`` with a figure and write it as PNG."""
    from cycler import cycler

    with plain_figures({**STYLE, "axes.prop_cycle": cycler(color=COLOURS)}):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        figure.savefig(path, metadata={"Software": None})
