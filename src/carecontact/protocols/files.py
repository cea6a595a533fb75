"""Finds protocol files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from carecontact.errors import ConfigError, UnknownNameError

OF_RELEASE_0_1_0 = frozenset(("bathing-v1", "bathing-v2", "bathing-moved-v1", "bathing-wide-v1", "bathing-droid-v1"))
"""Protocols that this release no longer has: a release reproduces its own results and no earlier ones."""


def shipped_protocols() -> list[str]:
    """Return ids of the protocols that come with carecontact."""
    folder = resources.files("carecontact.protocols")
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def protocol_file(name_or_path: str) -> Path:
    """Return the file of a shipped protocol, or the TOML file itself.

    Raises UnknownNameError for a name that is neither, or ConfigError for a file that is missing and for a protocol of
    an earlier release.
    """
    if name_or_path in OF_RELEASE_0_1_0:
        raise ConfigError(
            f"no protocol named {name_or_path!r}: release 0.1.0 has it, and reproduces its results; valid here: "
            f"{', '.join(shipped_protocols())}"
        )
    if name_or_path in shipped_protocols():
        return Path(str(resources.files("carecontact.protocols") / f"{name_or_path}.toml"))
    if not name_or_path.endswith(".toml"):
        if Path(f"{name_or_path}.toml").is_file():
            raise ConfigError(f"no protocol named {name_or_path!r} (did you mean {name_or_path}.toml?)")
        raise UnknownNameError("protocol", name_or_path, shipped_protocols())
    if not Path(name_or_path).is_file():
        raise ConfigError(f"protocol file {name_or_path} does not exist")
    return Path(name_or_path)
