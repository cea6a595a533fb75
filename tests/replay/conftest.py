"""A short trial of a real simulation in which the tool presses the forearm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording, write_recording

HZ = 20.0
DEEP_M = 0.022
"""How far below the top of the forearm the tool is commanded."""


def press() -> Recording:
    """Two chunks of poses that end below the skin; the tool is there when the second look is made."""
    card = PolicyCard(name="press", modalities=("rgb", "depth"), cameras=("overhead",), control_hz=HZ)
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="press")
    with Episode(spec, card=card) as episode:
        first = episode.reset()
        data, region = episode.simulation.data, episode.simulation.scene.frames["forearm"]
        top = data.site("region_forearm").xpos + [0, 0, region.size_m[2] - DEEP_M]
        start = first.pose_tcp_in_base
        goal = start.copy()
        goal[:3] = episode.simulation.encoders.in_base(data, top, np.eye(3))[:3, 3]
        way = [start + share * (goal - start) for share in np.linspace(0, 1, 50)[1:]]
        for number, pose in enumerate(way):
            step = episode.step(Action(pose_tcp_in_base=pose), observe=number == len(way) - 1)
        assert step.observation is not None
        for number in range(16):
            episode.step(Action(stiffness=(600.0, 20.0), done=number == 15), observe=False)
        return episode.finish()


@pytest.fixture(scope="session")
def pressed() -> Recording:
    return press()


@pytest.fixture
def pressed_file(pressed: Recording, tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    return write_recording(pressed, tmp_path / "run" / "T1-s000.h5")
