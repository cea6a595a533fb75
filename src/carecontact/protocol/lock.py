"""The lock beside a frozen protocol: hashes and versions of what its numbers depend on, as they were then."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from carecontact.errors import ConfigError
from carecontact.protocol.gates import Section
from carecontact.protocol.load import load_protocol, protocol_file, shipped_protocols
from carecontact.protocol.overrides import without_overrides
from carecontact.protocol.protocol import Protocol

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
    """Return the path of the lock: beside the protocol's file, one for each of its levels."""
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


DRIFTED = "lock"
"""The override that marks a run on a protocol that differs from its lock."""


def frozen_state(protocol: Protocol) -> str:
    """``frozen``, ``draft``, or a sentence that begins with ``not``. Announced overrides are put back first."""
    if DRIFTED in protocol.overrides:
        return f"not the frozen {protocol.id}: {protocol.overrides[DRIFTED]}"
    lock = read_lock(protocol.id, level=protocol.level) if protocol.id in shipped_protocols() else None
    if lock is None:
        unverified = "not verified as frozen: it says frozen = true, but no lock is installed for it"
        return unverified if protocol.frozen else "draft"
    own = without_overrides(protocol, load_protocol(protocol.id, level=protocol.level or None))
    if own.sha256 != lock.protocol_sha256:
        return f"not the frozen {protocol.id}: sha256 {own.sha256[:12]}, locked {lock.protocol_sha256[:12]}"
    return "frozen"


def drifted_sha256(protocol_id: str, sha256: str) -> str | None:
    """Return how a protocol (its name with the level, and its hash) differs from its lock; None where it does not."""
    own_id, _, level = protocol_id.partition(" ")
    lock = read_lock(own_id, level=level) if own_id in shipped_protocols() else None
    if lock is None or lock.protocol_sha256 == sha256:
        return None
    return f"not the frozen {protocol_id} (sha256 {sha256[:12]}, locked {lock.protocol_sha256[:12]})"
