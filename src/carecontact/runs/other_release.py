"""Messages about a run's folder that another release, or an earlier source of the policy, has started."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from carecontact import __version__
from carecontact.errors import RecordingError, counted
from carecontact.recording import read_header

ANOTHER = "use another folder"
ELSEWHERE = f"{ANOTHER}, or move this one aside, as --restart of `carecontact run` does"


def install_line(*, held: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Return the line that installs what a folder was started with, as far as it differs; empty where nothing does."""
    differ = [name for name, version in held.items() if now.get(name, version) != version]
    if not differ:
        return ""
    # A release of carecontact brings the packages that it needs.
    needed = ["carecontact"] if "carecontact" in differ else differ
    return f"to continue it: python -m pip install {' '.join(map(_requirement, needed, map(held.get, needed)))}"


def _requirement(name: str, version: str | None) -> str:
    return f"carecontact-{version}-*.whl" if name == "carecontact" else f"{name}=={version}"


def damaged(content: bytes) -> str:
    """Return how a manifest that cannot be read is described: by the release that wrote it, where it names another
    one."""
    with suppress(ValueError, KeyError, TypeError, RecursionError):
        version = str(cast("Any", json.loads(content))["identity"]["versions"]["carecontact"])
        if version != __version__:
            line = install_line(held={"carecontact": version}, now={"carecontact": __version__})
            return f"was written by carecontact {version}, and this is {__version__}; {line}"
    return "is damaged or of another release"


def lost_trials(out: Path, *, failed: tuple[str, ...]) -> str:
    """Return what of a folder cannot be kept because the policy's source changed.

    Args:
        failed: ends of trials that --retry-failed would run again.
    """
    ends: list[str] = []
    for path in out.glob("*.h5"):
        with suppress(RecordingError):
            ends.append(read_header(path).ended)
    n_failed = sum(end in failed for end in ends)
    trials = counted(len(ends), "trial")
    return f"none of its {trials}, {n_failed} of them failed, can be kept beside trials of the new source"
