"""Whether the rules that a recording carries are those that were frozen under their id; needs no simulator."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.protocols import load_protocol, shipped_protocols, without_overrides
from carecontact.protocols.lock import read_lock

DRIFTED = "lock"
"""The override that a run on a drifted protocol says so with."""


def frozen_state(protocol: Protocol) -> str:
    """``frozen``, ``draft``, or a sentence that begins with ``not``: what it differs from, or that nothing here tells.

    Announced overrides, which every title names, are put back first.
    """
    if DRIFTED in protocol.overrides:
        return f"not what was frozen as {protocol.id}: {protocol.overrides[DRIFTED]}"
    lock = read_lock(protocol.id) if protocol.id in shipped_protocols() else None
    if lock is None:
        return "not known to be frozen: it says so, and no lock is here" if protocol.frozen else "draft"
    own = without_overrides(protocol, load_protocol(protocol.id))
    if own.sha256 != lock.protocol_sha256:
        return f"not what was frozen as {protocol.id}: sha256 {own.sha256[:12]}, locked {lock.protocol_sha256[:12]}"
    return "frozen"


def drifted_sha256(protocol_id: str, sha256: str) -> str | None:
    """What is wrong with a protocol without overrides of which only id and hash are known; None where nothing is."""
    lock = read_lock(protocol_id) if protocol_id in shipped_protocols() else None
    if lock is None or lock.protocol_sha256 == sha256:
        return None
    return f"not what was frozen as {protocol_id} (sha256 {sha256[:12]}, locked {lock.protocol_sha256[:12]})"
