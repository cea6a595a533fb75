"""What numbers look like, from the numbers alone."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.trials.deep.columns import (
    joints_of,
    look_at_gripper,
    look_at_joints,
    look_at_polarity,
    numbers_of,
    table,
)

VELOCITY, POSITION = "droid_joint_velocity", "joint_position"
POSTURES = {
    "bathing-v3-draft": np.array([0.53, -0.39, 0.36, -1.84, 0.14, 1.47, 1.14]),
    "DROID": np.array([0.0, -0.628, 0.0, -2.513, 0.0, 1.885, 0.0]),
}


def topics(joints: np.ndarray, space: str, now: np.ndarray) -> list[str]:
    return [found.topic for found in look_at_joints(joints, space=space, now=now)]


@pytest.mark.parametrize("posture", POSTURES)
def test_what_looks_right_and_what_looks_wrong(posture: str) -> None:
    now, rng = POSTURES[posture], np.random.default_rng(0)
    for size in (0.0, 0.02, 0.3, 1.0):
        velocities = rng.uniform(-size, size, (15, 7))
        targets = now + np.cumsum(velocities, axis=0) * 0.05
        assert topics(velocities, VELOCITY, now) == []
        assert topics(targets, POSITION, now) == []
        assert topics(targets, VELOCITY, now) == ["velocities"]
        assert topics(np.degrees(targets), VELOCITY, now) == ["degrees"]
        assert topics(np.degrees(targets), POSITION, now) == ["degrees"]
    assert topics(rng.uniform(-0.3, 0.3, (15, 7)), POSITION, now) == ["targets"]
    # The fastest velocities, toward the angles that the arm has: nothing looks more like targets.
    assert topics(np.tile(np.clip(now, -1, 1), (15, 1)), VELOCITY, now) == []
    assert topics(rng.uniform(-2, 2, (15, 7)), VELOCITY, now) == ["velocities"]


@pytest.mark.parametrize(
    ("commands", "level"),
    [([1, 1], None), ([0, 1], None), ([0, 0.1], "hint"), ([-0.05, 1.05], None), ([0, 1.3], "warning"),
     ([-1, 1], "warning"), ([0, 255], "warning")],
)  # fmt: skip
def test_the_gripper(commands: list[float], level: str | None) -> None:
    assert [found.level for found in look_at_gripper(np.array(commands))] == ([] if level is None else [level])


def test_polarity() -> None:
    zero, one = np.zeros(3), np.ones(3)
    assert [found.level for found in look_at_polarity(zero, one)] == ["warning"]
    assert list(look_at_polarity(one, zero)) == []
    assert list(look_at_polarity(zero, zero)) == []


def test_the_table() -> None:
    values = np.zeros((4, 9))
    values[1, 2] = np.nan
    values[:, 3] = np.nan
    lines = table(values, now=np.arange(7.0), kind="joints")
    assert lines[2].split() == ["joint", "3", "0.000", "to", "0.000;", "the", "angle", "is", "2.000", "rad;", "1", "of",
                                "4", "are", "not", "finite"]  # fmt: skip
    assert "no number" in lines[3]
    assert lines[7].startswith("gripper")
    assert lines[8].startswith("column 9, unknown")


def test_numbers_of_actions() -> None:
    joint = np.arange(7.0)
    assert joints_of([Action(joint=joint), Action()]) is None
    assert (joints_of([Action(joint=joint)]) == joint).all()
    numbers = numbers_of([Action(joint=joint, gripper=0.5), Action(done=True)])
    assert numbers.shape[0] == 2
    assert 0.5 in numbers[0]
    assert numbers[1].sum() == 1
