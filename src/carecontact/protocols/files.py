"""Finds protocol files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from carecontact.errors import ConfigError, UnknownNameError

EARLIER = {
    "bathing-v1": "7076c1d2648cc214270a946eadef89bfea3d74bf",
    "bathing-moved-v1": "5eab211a09649f150689eb92f0bf99efe21019bb",
    "bathing-v2": "663c7e2317bf04e7b79c6a85d596936bd4fd816c",
    "bathing-wide-v1": "663c7e2317bf04e7b79c6a85d596936bd4fd816c",
}
"""Protocol that this release no longer has -> the commit that reproduces its results (CHANGELOG.md)."""


def shipped_protocols() -> list[str]:
    """Return ids of the protocols that come with carecontact."""
    folder = resources.files("carecontact.protocols")
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml"))


def protocol_file(name_or_path: str) -> Path:
    """Return the file of a shipped protocol, or the TOML file itself.

    Raises UnknownNameError for a name that is neither, or ConfigError for a file that is missing and for a protocol of
    an earlier release.
    """
    if commit := EARLIER.get(name_or_path):
        raise ConfigError(
            f"no protocol named {name_or_path!r}: commit {commit} has it, and reproduces its results; valid here: "
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
