"""matplotlib with its own settings: MPLBACKEND and matplotlibrc files, which other programs of the user need, change no
figure of this one and keep none from being drawn."""

from __future__ import annotations

import os
import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from carecontact.errors import ConfigError

BACKEND = "MPLBACKEND"


def import_matplotlib() -> Any:
    """Return the package. Raises ConfigError for a matplotlibrc file that it cannot read."""
    if "matplotlib" in sys.modules:
        return sys.modules["matplotlib"]
    given = os.environ.pop(BACKEND, None)
    try:
        import matplotlib
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
    """Draw and save figures inside the block, or in a function that this decorates, with matplotlib's own settings.

    Args:
        style: settings in place of some of these.

    Raises ConfigError as ``import_matplotlib``.
    """
    matplotlib = import_matplotlib()
    own = {name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"}
    with matplotlib.rc_context({**own, **(style or {})}):
        yield
