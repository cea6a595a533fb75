"""The folder in which the benchmark keeps what it would otherwise compute in every trial (``world.kept``)."""

from __future__ import annotations

import os
from pathlib import Path

CACHE_VARIABLE = "CARECONTACT_CACHE"
"""Environment variable with the path of the folder; if it is empty, nothing is kept."""


def cache_folder() -> Path | None:
    """Return the folder of kept files; None if nothing is to be kept, or the user has no home folder."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # HOME is not set, and the system knows no home folder of this user.
        return None
    return Path(base) / "carecontact"
