"""Make one sweep of its parts, which ran on several machines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.runs.manifest import MANIFEST
from carecontact.runs.merge import Merged, check_places, merge_runs
from carecontact.runs.sweep.cells import CELLS


def is_sweep(folder: Path) -> bool:
    return (folder / CELLS).is_dir()


def merge_sweeps(out: Path, sweeps: Sequence[Path]) -> dict[str, Merged]:
    """Merge every cell that any of ``sweeps`` has begun into the same cell of ``out``; cell -> what became of it.

    A cell of which several parts ran trials is one run in the end. The same command continues an interrupted merge.

    Raises as ``merge_runs``, also for a folder that is no sweep. Cells before the one that it names are then merged.
    """
    check_places(out, sweeps)
    found: dict[str, list[Path]] = {}
    for sweep in sweeps:
        if not is_sweep(sweep):
            raise ConfigError(f"{sweep} is not a sweep: it holds no folder {CELLS}; name the --out of a sweep's parts")
        for cell in sorted((sweep / CELLS).iterdir()):
            if (cell / MANIFEST).is_file():
                found.setdefault(cell.name, []).append(cell)
    return {name: merge_runs(out / CELLS / name, folders) for name, folders in found.items()}
