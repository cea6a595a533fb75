"""The lock beside a frozen protocol: hashes and versions of what its numbers depend on, as they were then."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from carecontact.contract.protocol import Section
from carecontact.errors import ConfigError
from carecontact.protocols import protocol_file

SUFFIX = ".lock.json"


class Lock(Section):
    id: str
    protocol_sha256: str
    """Hash of the fields, tissue laws included: see ``Protocol.sha256``."""
    fields: dict[str, Any]
    """All of them as they were, defaults included, so that one that changed can be named."""
    embodiment: str
    versions: dict[str, str]
    """Packages whose release changes the physics or what is seen."""
    assets: dict[str, str]
    """Place under carecontact/assets -> sha256."""
    worlds: dict[str, dict[str, float]]
    """Target region, with the body where bodies vary -> sums over the compiled world. Sums and not a hash of it:
    another processor rounds otherwise."""


def lock_path(name_or_path: str, *, level: str = "") -> Path:
    """Return the path of the lock: beside the protocol's file, one for each of its levels. Raises what
    ``protocol_file`` raises."""
    path = protocol_file(name_or_path)
    return path.with_name(path.name.removesuffix(".toml") + (f".{level}" if level else "") + SUFFIX)


def read_lock(name_or_path: str, *, level: str = "") -> Lock | None:
    """Return the lock of a protocol; None where it has none. Raises ConfigError for a lock that cannot be read."""
    path = lock_path(name_or_path, level=level)
    try:
        return Lock.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(f"{path}: not a lock: {'.'.join(map(str, first['loc'])) or 'file'}: {first['msg']}") from None


def write_lock(lock: Lock, path: Path) -> None:
    path.write_text(json.dumps(lock.model_dump(mode="json"), indent=1, sort_keys=True) + "\n", encoding="ascii")
