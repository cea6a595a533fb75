"""Finds protocol files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from carecontact.errors import ConfigError, UnknownNameError

SUCCESSORS = {
    "bathing-v1": "bathing-v2",
    "bathing-moved-v1": "bathing-wide-v1",
    "bathing-droid-v1": "bathing-droid-draft",
}
"""Protocol of an earlier release, which had another model of the tissue -> the one that took its place."""


def shipped_protocols() -> list[str]:
    """Return ids of the protocols that come with carecontact."""
    folder = resources.files("carecontact.protocols")
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def protocol_file(name_or_path: str) -> Path:
    """Return the file of a shipped protocol, or the TOML file itself.

    Raises UnknownNameError for a name that is neither, or ConfigError for a file that is missing and for a protocol of
    an earlier release.
    """
    if name_or_path in SUCCESSORS:
        raise ConfigError(no_longer(name_or_path))
    if name_or_path in shipped_protocols():
        return Path(str(resources.files("carecontact.protocols") / f"{name_or_path}.toml"))
    if not name_or_path.endswith(".toml"):
        if Path(f"{name_or_path}.toml").is_file():
            raise ConfigError(f"no protocol named {name_or_path!r} (did you mean {name_or_path}.toml?)")
        raise UnknownNameError("protocol", name_or_path, shipped_protocols())
    if not Path(name_or_path).is_file():
        raise ConfigError(f"protocol file {name_or_path} does not exist")
    return Path(name_or_path)


def no_longer(name: str) -> str:
    """Return the message about a protocol of an earlier release, which names its successor."""
    return (
        f"no protocol named {name!r}: earlier releases had it, with another model of the tissue; its successor is "
        f"{SUCCESSORS[name]!r}, whose results cannot be compared with those of {name!r}"
    )
