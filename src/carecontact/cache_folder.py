"""The folder in which the benchmark keeps what it would otherwise compute in every trial (``world.kept``)."""

from __future__ import annotations

import os
from pathlib import Path

CACHE_VARIABLE = "CARECONTACT_CACHE"
"""Environment variable with the path of the folder; if it is empty, nothing is kept."""


def cache_folder() -> Path | None:
    """Return the folder of kept files; None if nothing is to be kept."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "carecontact"
