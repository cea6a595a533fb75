from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carecontact.contract.action import check_action
from carecontact.contract.observation import CameraView
from carecontact.policies.hover import HEIGHT_M, HOLD_S, Hover
from tests.policies.synthetic import BOUNDS, synthetic_observation

RADIUS, TOP, MIDDLE = 0.04, 0.08, np.array([0.40, -0.05])
ELBOW_X, WRIST_X = 0.27, 0.53


def _forearm_from_above() -> CameraView:
    """A half cylinder along x on a bed at z = 0, seen by a camera 1 m above the bed."""
    width, height, focal = 200, 140, 250.0
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = [*MIDDLE, 1.0]
    u, v = np.meshgrid(np.arange(width) - width / 2, np.arange(height) - height / 2)
    z = np.zeros((height, width))
    for _ in range(30):
        x, y = MIDDLE[0] + u * (1 - z) / focal, MIDDLE[1] - v * (1 - z) / focal
        across = RADIUS**2 - (y - MIDDLE[1]) ** 2
        on_arm = (across > 0) & (x > ELBOW_X) & (x < WRIST_X)
        z = np.where(on_arm, TOP - RADIUS + np.sqrt(np.maximum(across, 0)), 0.0)
    landmarks = np.zeros((33, 3), np.float32)
    landmarks[:, 2] = 1
    surface = np.full((33, 3), np.nan, np.float32)
    surface[14], surface[16] = [ELBOW_X, MIDDLE[1], TOP], [WRIST_X, MIDDLE[1], TOP]
    return CameraView(
        intrinsics=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]),
        pose_camera_in_base=pose,
        depth=(1.0 - z).astype(np.float32),
        points=np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32),
        point_colors=np.zeros((width * height, 3), np.uint8),
        masks={
            "human": on_arm,
            "robot": np.zeros_like(on_arm),
            "bed": ~on_arm,
            "background": np.zeros_like(on_arm),
        },
        landmarks=landmarks,
        landmarks_in_base=surface,
    )


@pytest.mark.parametrize("verb", ["push", "tap"])
def test_hover_waits_over_the_region_and_never_comes_nearer(verb: str) -> None:
    """Whatever the action is, also one of another package."""
    policy = Hover()
    policy.reset(f"{verb} the right forearm")
    actions = policy.act(synthetic_observation(cameras={"overhead": _forearm_from_above()}))
    poses = np.array([check_action(action, BOUNDS).pose_tcp_in_base for action in actions])
    assert [action.done for action in actions] == [False] * (len(actions) - 1) + [True]
    goal = np.array([*MIDDLE, TOP + HEIGHT_M])
    waiting = np.linalg.norm(poses[:, :3] - goal, axis=1) < 0.01
    assert waiting.sum() / policy.card.control_hz == pytest.approx(HOLD_S, abs=1.5)
    assert np.ptp(poses[waiting][10:-10, :3], axis=0).max() == pytest.approx(0, abs=0.01)
    assert poses[:, 2].min() > TOP + HEIGHT_M - 0.01
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) * policy.card.control_hz
    assert steps.max() <= 0.25 + 1e-9


def test_hover_that_finds_nobody_ends_where_it_is() -> None:
    policy = Hover()
    policy.reset("gently touch the right upper arm")
    view = dataclasses.replace(_forearm_from_above(), landmarks=np.full((33, 3), np.nan, np.float32))
    (action,) = policy.act(synthetic_observation(cameras={"overhead": view}))
    assert action.done
    assert action.pose_tcp_in_base is None
