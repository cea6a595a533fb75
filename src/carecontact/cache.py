"""Arrays that are kept on disk between trials, since computing them takes longer than loading them.

A file's name is a hash of all that its arrays depend on, so that it is never out of date. Stored arrays equal computed
ones, so that recordings do not depend, in any bit, on whether arrays were stored.

A settled person is what no policy may see. The folder is closed to a policy that runs isolated
(``serving.process``). The hash has a secret of the folder as its key, because the system still tells such a
policy the times of every file whose path it can guess, and so which seed's person was just kept.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.system import cache_folder

Arrays = dict[str, npt.NDArray[Any]]

DIGEST = "sha256"
"""Name of the array in a file that holds the hash of all others."""
SECRET, SECRET_BYTES = "secret", 32
"""File of the folder that holds the key of its names."""


def cached(kind: str, facts: Mapping[str, object], compute: Callable[[], Arrays]) -> Arrays:
    """Return what ``compute`` returned earlier for the same facts; if nothing is kept, call it and keep its result.

    Args:
        kind: folder for arrays of this kind.
        facts: all that the arrays depend on, in values that JSON can hold.
    """
    folder = cache_folder()
    if folder is None:
        return compute()
    try:
        secret = _secret(folder)
    except OSError:
        return compute()
    path = folder / kind / f"{hmac.digest(secret, json.dumps(facts, sort_keys=True).encode(), 'sha256').hex()}.npz"
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


def _secret(folder: Path) -> bytes:
    """Return the folder's secret, which the first process draws. If two draw one at the same time, the later one stays;
    what was kept with the other is computed again."""
    path = folder / SECRET
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".part", delete=False) as file:
            file.write(secrets.token_bytes(SECRET_BYTES))
        os.replace(file.name, path)
    return path.read_bytes()


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
