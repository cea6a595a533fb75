"""The exam with foam on the skin and the mitt, as tests of foam use it."""

from __future__ import annotations

from pathlib import Path

from carecontact.protocol.load import load_levels
from carecontact.protocol.protocol import Protocol

LEVELS = load_levels(str(Path(__file__).parents[2] / "examples" / "bathing-wide-foam.toml"))
FOAMY = LEVELS["L1"]


def with_foam(protocol: Protocol) -> Protocol:
    """Another protocol of the exam's gates with the foam and the mitt."""
    gates = protocol.gates.model_copy(update={"foam": FOAMY.gates.foam})
    scene = protocol.scene.model_copy(update={"tool": FOAMY.scene.tool})
    return protocol.model_copy(update={"gates": gates, "foam": FOAMY.foam, "scene": scene})
