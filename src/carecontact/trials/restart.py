"""Move an earlier run aside, so that its folder can begin anew."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.runs.alone import LOCK
from carecontact.runs.manifest import MANIFEST
from carecontact.trials.work_folder import remove_abandoned


def move_aside(out: Path) -> Path | None:
    """Rename the folder of a run to ``NAME.before-1``, or the next number that is free; nothing is deleted.

    Call it inside ``alone``, whose lock does not move: lock the folder again.

    Returns the new place, or None where there is nothing to move. Raises ConfigError for a folder that is not a run,
    that this command stands in or that cannot be moved.
    """
    if not out.exists() or (out.is_dir() and all(path.name == LOCK for path in out.iterdir())):
        return None
    if not (out / MANIFEST).is_file():
        raise ConfigError(f"--restart: {out} is not a run: it holds no {MANIFEST}; use another --out")
    place = out.absolute()
    if Path.cwd().is_relative_to(out.resolve()):
        raise ConfigError(f"--restart: {out} is the current folder or around it; change to another folder first")
    remove_abandoned(out)
    moved = next(path for k in count(1) if not (path := place.with_name(f"{place.name}.before-{k}")).exists())
    try:
        place.rename(moved)
    except OSError as error:
        raise ConfigError(f"--restart: {out} cannot be moved to {moved}: {error.strerror}") from None
    (moved / LOCK).unlink(missing_ok=True)
    return out.with_name(moved.name) if out.name else moved
