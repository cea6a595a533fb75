from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.contract.geometry import matrix_from_quat
from carecontact.policies.motion import ROTATION_SPEED_RAD_S, Leg, sample, slerp, tool_quat

HZ = 20.0
DOWN = np.array([0.0, 1.0, 0.0, 0.0])


@given(
    goal=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    speed=st.floats(0.02, 0.25),
    angle=st.floats(0, 3.0),
)
def test_sampled_motion_keeps_its_speed_and_arrives(
    goal: tuple[float, float, float], speed: float, angle: float
) -> None:
    start = np.array([0.0, 0.0, 0.0, *DOWN])
    quat = slerp(DOWN, np.array([0.0, 0.0, 1.0, 0.0]), angle / np.pi)
    poses = np.array(
        [start, *sample([Leg(points=np.array([goal]), quat_wxyz=quat, speed_m_s=speed)], start, control_hz=HZ)]
    )
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) * HZ
    turns = 2 * np.arccos(np.clip(np.abs((poses[1:, 3:] * poses[:-1, 3:]).sum(1)), 0, 1)) * HZ
    assert (steps <= speed * (1 + 1e-9)).all()
    assert (turns <= ROTATION_SPEED_RAD_S + 1e-3).all()
    if len(poses) > 1:
        np.testing.assert_allclose(poses[-1, :3], goal, atol=1e-9)
        assert abs(poses[-1, 3:] @ quat) == pytest.approx(1.0)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1)


def test_a_hold_lasts_as_long_as_it_says() -> None:
    start = np.array([0.0, 0.0, 0.0, *DOWN])
    leg = Leg(points=np.array([[0.0, 0, 0.1]]), quat_wxyz=DOWN, speed_m_s=0.1, hold_s=1.5)
    poses = np.array(list(sample([leg], start, control_hz=HZ)))
    assert (poses[:, 2] == 0.1).sum() == 1 + 30


def test_tool_points_where_it_should() -> None:
    rotation = matrix_from_quat(tool_quat(np.array([0.0, 0.3, -1.0]), np.array([1.0, 0.0, 0.0])))
    np.testing.assert_allclose(rotation[:, 2], np.array([0, 0.3, -1]) / np.hypot(0.3, 1), atol=1e-9)
    np.testing.assert_allclose(rotation[:, 0], [1, 0, 0], atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
