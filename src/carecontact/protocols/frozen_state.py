"""Whether the protocol of a recording is the one that was frozen under its id; needs no simulator."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.protocols import load_protocol, shipped_protocols, without_overrides
from carecontact.protocols.lock import read_lock

DRIFTED = "lock"
"""The override that marks a run on a protocol that differs from its lock."""


def frozen_state(protocol: Protocol) -> str:
    """``frozen``, ``draft``, or a sentence that begins with ``not``: what it differs from, or that no lock is here.

    Announced overrides, which every title names, are put back first.
    """
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
    """Return what is wrong with a protocol without overrides of which only name and hash are known; None where nothing
    is.

    ``protocol_id``: with the level, as results name it.
    """
    own_id, _, level = protocol_id.partition(" ")
    lock = read_lock(own_id, level=level) if own_id in shipped_protocols() else None
    if lock is None or lock.protocol_sha256 == sha256:
        return None
    return f"not the frozen {protocol_id} (sha256 {sha256[:12]}, locked {lock.protocol_sha256[:12]})"
