"""Arrays that are kept on disk between trials, since computing them takes longer than loading them.

A file's name is a hash of all that its arrays depend on, so that it is never out of date. Stored arrays equal computed
ones, so that recordings do not depend, in any bit, on whether arrays were stored.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[Any]]

CACHE_VARIABLE = "CARECONTACT_CACHE"
"""Environment variable with the path of the folder; if it is empty, nothing is kept."""
DIGEST = "sha256"
"""Name of the array in a file that holds the hash of all others."""


def cache_folder() -> Path | None:
    """Return the folder of kept files; None if nothing is to be kept."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "carecontact"


def kept(kind: str, facts: Mapping[str, object], compute: Callable[[], Arrays]) -> Arrays:
    """Return what ``compute`` returned earlier for the same facts; if nothing is kept, call it and keep its result.

    Args:
        kind: folder for arrays of this kind.
        facts: all that the arrays depend on, in values that JSON can hold.
    """
    folder = cache_folder()
    if folder is None:
        return compute()
    path = folder / kind / f"{hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()}.npz"
    known = _read(path)
    if known is not None:
        return known
    arrays = compute()
    _write(path, arrays)
    return arrays


@cache
def source_sha256(folder: Path) -> str:
    """Return the hash of all modules in a folder and below it, as a fact of arrays that they compute."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.rglob("*.py")))).hexdigest()


def _read(path: Path) -> Arrays | None:
    """Return the arrays of a file; None if it is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays: Arrays = dict(stored)
            return arrays if str(arrays.pop(DIGEST)) == _digest(arrays) else None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _write(path: Path, arrays: Arrays) -> None:
    """Write the file completely or not at all, since trials run at the same time. If the folder cannot be written to,
    the only loss is time.
    """
    part = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            part = Path(file.name)
            np.savez(file, allow_pickle=False, **arrays, **{DIGEST: np.array(_digest(arrays))})
        os.replace(part, path)
    except OSError:
        if part is not None:
            part.unlink(missing_ok=True)


def _digest(arrays: Arrays) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
