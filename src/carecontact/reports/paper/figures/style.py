"""One style for the figures, and their files: the same content gives the same bytes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carecontact.plotting import plain_figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
