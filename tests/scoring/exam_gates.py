"""The paper's protocol under exam."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.protocols import load_protocol

GATES = load_protocol("bathing-wide-v2-draft", level="L0").gates
TABLE = GATES.model_dump(mode="json")


def gently(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"gates": GATES})


GENTLE = gently(load_protocol("bathing-v3-draft"))
