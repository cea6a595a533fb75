"""The draft protocol under gates-v2."""

from __future__ import annotations

import tomllib
from pathlib import Path

from carecontact.contract.protocol import Gates, Protocol
from carecontact.protocols import load_protocol

TABLE = tomllib.loads((Path(__file__).parent / "gates-v2.toml").read_text())["gates"]
GATES = Gates.model_validate(TABLE)


def gently(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"gates": GATES})


GENTLE = gently(load_protocol("bathing-draft"))
