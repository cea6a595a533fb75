"""The files of all shipped bodies, which are read together.

Were only the body of a trial read, an isolated policy could tell from access times, or from what the system keeps in
memory, which person the trial before its own had."""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from importlib import resources
from pathlib import Path


def body_file(name: str) -> bytes:
    """Return the content of a file in the folder of bodies. Raises OSError for one that cannot be read."""
    folder = body_folder()
    found = _contents(folder)
    return found[name] if name in found else (folder / name).read_bytes()


def body_folder() -> Path:
    return Path(str(resources.files("carecontact") / "assets" / "bodies"))


@cache
def _contents(folder: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for path in sorted(folder.iterdir()):
        with suppress(OSError):
            found[path.name] = path.read_bytes()
    return found
