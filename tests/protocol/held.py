"""A frozen protocol that is shipped with its lock for the length of one test."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from carecontact.protocol import load
from carecontact.protocol.load import load_protocol, protocol_file, shipped_protocols
from carecontact.protocol.lock import lock_path, write_lock
from carecontact.protocol.protocol import Protocol

HELD = "held-v1"


def frozen_text(name: str = HELD) -> str:
    """The file of bathing-v3 under another id."""
    return protocol_file("bathing-v3").read_text(encoding="utf-8").replace('id = "bathing-v3"', f'id = "{name}"')


def ship_frozen(monkeypatch: pytest.MonkeyPatch, folder: Path, *, worlds: bool = False) -> Protocol:
    """Put HELD and its lock beside copies of the shipped ones and let ``folder`` be where protocols are shipped.

    Args:
        worlds: put sums of the compiled worlds into the lock; some seconds.
    """
    from carecontact.runs.identity import make_lock

    text = frozen_text()
    for name in shipped_protocols():
        shutil.copy(protocol_file(name), folder)
    (folder / f"{HELD}.toml").write_text(text, encoding="utf-8")
    monkeypatch.setattr(load, "resources", SimpleNamespace(files=lambda package: folder))
    protocol = load_protocol(HELD)
    write_lock(make_lock(protocol, worlds=worlds), lock_path(HELD))
    return protocol
