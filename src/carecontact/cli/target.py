"""The place of a file that a command writes."""

from __future__ import annotations

from pathlib import Path

from carecontact.errors import ConfigError


def make_place(target: Path) -> None:
    """Make the folder in which a file is to be written. Raises ConfigError where that cannot be done, and where the
    file's name is that of a folder."""
    if target.is_dir():
        raise ConfigError(f"{target}: this is a folder; name a file")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        told = "this is a file" if isinstance(error, FileExistsError) else error.strerror
        raise ConfigError(f"{target}: no folder can be made for it: {error.filename}: {told}") from None
