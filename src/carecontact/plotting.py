"""How figures are drawn: without a display, in one style, whatever other programs have set for matplotlib."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carecontact.errors import ConfigError, DependencyError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# matplotlib with its own settings: MPLBACKEND and matplotlibrc files, which other programs of the user need, change no
# figure of this one and keep none from being drawn.

BACKEND = "MPLBACKEND"


def import_matplotlib() -> Any:
    """Return the package. Raises DependencyError without it, ConfigError for a matplotlibrc file it cannot read."""
    if "matplotlib" in sys.modules:
        return sys.modules["matplotlib"]
    given = os.environ.pop(BACKEND, None)
    try:
        import matplotlib
    except ImportError:
        raise DependencyError("figures need matplotlib: pip install 'carecontact[figures]'") from None
    except (ValueError, OSError) as error:
        raise ConfigError(
            "matplotlib cannot read a matplotlibrc file (in the current folder, in the one that MATPLOTLIBRC names, or "
            f"in the user's): {error}"
        ) from None
    finally:
        if given is not None:
            os.environ[BACKEND] = given
    # A program that draws figures of its own in this process still gets the backend that it expects.
    if given is not None:
        with suppress(ValueError):
            matplotlib.rcParams["backend"] = given
    return matplotlib


@contextmanager
def plain_figures(style: Mapping[str, Any] | None = None) -> Generator[None]:
    """Draw inside the block, or a decorated function, with matplotlib's own settings and ``style``."""
    matplotlib = import_matplotlib()
    own = {name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"}
    with matplotlib.rc_context({**own, **(style or {})}):
        yield


# One style for every figure, drawn without a display.

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
