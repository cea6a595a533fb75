"""Whether the foam of every person can be seen: a threshold on colour in the first overhead picture of all tasks."""

from __future__ import annotations

import numpy as np
import pytest

from tests.episode.test_foam import NEAR_PX, first_picture, pixels_of
from tests.protocol.foamy import LEVELS

pytestmark = pytest.mark.slow
SEEDS = range(27)
LEAST_SHARE = 0.99
LEAST_PX = 25
"""Fewest pixels that count as found: a square of 15 mm on the skin."""


@pytest.mark.parametrize("level", ["L1", "L2"])
def test_a_threshold_finds_the_foam_at_its_place_and_nowhere_else(level: str) -> None:
    """L3 begins as L2 does."""
    protocol, missed, counts = LEVELS[level], list[str](), list[int]()
    for task_id in (task.id for task in protocol.tasks if protocol.has_foam(task.id)):
        for seed in SEEDS:
            picture, simulation, middle = first_picture(protocol, task_id, seed)
            assert simulation.scene.foam is not None
            found = np.argwhere(pixels_of(simulation.scene.foam.colour, picture))[:, ::-1]
            near = np.linalg.norm(found - middle, axis=1) < NEAR_PX
            counts.append(int(near.sum()))
            if near.sum() < LEAST_PX or not near.all():
                missed.append(f"{task_id} seed {seed}: {near.sum()} near, {(~near).sum()} elsewhere")
    assert len(missed) <= (1 - LEAST_SHARE) * len(counts), missed
