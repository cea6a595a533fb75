"""A world whose hidden mechanics are random numbers is still one that can be drawn."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.audit.frozen import HIDDEN_OF_MODEL, scrambled_model
from carecontact.protocols import load_protocol
from carecontact.world.scene import build_scene


@pytest.mark.parametrize(
    ("protocol", "level"),
    [("bathing-v3-draft", None), ("bathing-wide-v2-draft", "L3")],
)
def test_the_compiled_tissue_takes_every_scrambled_model(protocol: str, level: str | None) -> None:
    model = build_scene(load_protocol(protocol, level=level), target="forearm", skin=False).model
    for seed in range(8):
        other = scrambled_model(model, np.random.default_rng(seed))
        mujoco.MjData(other)
    for name in HIDDEN_OF_MODEL:
        assert (getattr(other, name) != getattr(model, name)).any(), name
