"""The exam, as tests of foam use it."""

from __future__ import annotations

from carecontact.protocol.load import load_levels
from carecontact.protocol.protocol import Protocol

LEVELS = load_levels("bathing-wide-v2")
FOAMY = LEVELS["L1"]


def with_foam(protocol: Protocol) -> Protocol:
    """Another protocol of the exam's gates with the mitt, and with a wider patch of foam; its arm has no errors."""
    assert FOAMY.foam is not None
    foam = FOAMY.foam.model_copy(update={"oval_m": (0.05, 0.02), "room_m": 0.0})
    gates = protocol.gates.model_copy(update={"foam": FOAMY.gates.foam})
    scene = protocol.scene.model_copy(update={"tool": FOAMY.scene.tool})
    return protocol.model_copy(update={"gates": gates, "foam": foam, "scene": scene, "arm_errors": None})
