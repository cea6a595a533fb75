"""Episodes of policies that answer differences of the tool's pose: where the tool goes, and what is recorded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World
from carecontact.errors import ActionError
from carecontact.interface.action import Action
from carecontact.interface.deltas import DELTAS
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec
from carecontact.replay.replay import recorded_actions
from carecontact.scoring import score_recording

Prepare = Callable[[TrialSpec], World]
SIZE = 0.04
"""Declared way [m] of the tests: within the bound of every convention."""


def card(delta: str, **more: Any) -> PolicyCard:
    return PolicyCard(name=delta, cameras=(), control_hz=10, action_space="cartesian_delta", delta=delta, **more)


def rotation(pose: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose[3:], scalar_first=True)


def in_parts(numbers: np.ndarray, most: np.ndarray) -> list[np.ndarray]:
    """Equal deltas inside the bounds, which add up to ``numbers``; more than one only where the bounds demand it."""
    count = int(np.ceil((np.abs(numbers) / most).max()))
    return [numbers / count] * count


@pytest.mark.parametrize("delta", DELTAS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_moves_the_tool_along_that_axis_of_the_declared_frame_by_the_declared_metres(
    parked_world: Prepare, t1: TrialSpec, delta: str, axis: int
) -> None:
    """Within 2 %, and across it by less than 2 %, in free space; the tool has two seconds to arrive."""
    convention = DELTAS[delta]
    numbers = np.zeros(6)
    numbers[axis] = (1 if axis == 2 else -1) * SIZE / convention.unit[0]
    if convention.frame == "tool" and axis == 2:
        numbers *= -1  # The tool's z points down, and below it the person lies.
    with Episode(t1, card=card(delta), prepare=parked_world) as episode:
        before = episode.reset().pose_tcp_in_base
        parts = in_parts(numbers, convention.bounds)
        for part in parts:
            episode.step(Action(delta=part), observe=False)
        for _ in range(20 - len(parts)):
            episode.step(Action(), observe=False)
        after = episode.step(Action()).observation
        assert after is not None
    frame = np.eye(3) if convention.frame == "base" else rotation(before).as_matrix()
    moved = frame.T @ (after.pose_tcp_in_base[:3] - before[:3])
    expected = convention.unit[0] * numbers[:3]
    np.testing.assert_allclose(moved, expected, atol=0.02 * SIZE)
    assert (rotation(after.pose_tcp_in_base) * rotation(before).inv()).magnitude() < 0.01


@pytest.mark.parametrize("delta", DELTAS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_axis_turns_the_tool_about_that_axis_of_the_declared_frame(
    parked_world: Prepare, t1: TrialSpec, delta: str, axis: int
) -> None:
    convention = DELTAS[delta]
    numbers = np.zeros(6)
    numbers[3 + axis] = 0.2 / convention.unit[1]
    with Episode(t1, card=card(delta), prepare=parked_world) as episode:
        before = episode.reset().pose_tcp_in_base
        parts = in_parts(numbers, convention.bounds)
        for part in parts:
            episode.step(Action(delta=part), observe=False)
        for _ in range(20 - len(parts)):
            episode.step(Action(), observe=False)
        after = episode.step(Action()).observation
        assert after is not None
    start, end = rotation(before), rotation(after.pose_tcp_in_base)
    turn = end * start.inv() if convention.frame == "base" else start.inv() * end
    np.testing.assert_allclose(turn.as_rotvec(), 0.2 * np.eye(3)[axis], atol=0.02 * 0.2)
    np.testing.assert_allclose(after.pose_tcp_in_base[:3], before[:3], atol=1e-3)


def test_deltas_of_the_target_add_up_and_deltas_of_the_measured_pose_do_not(
    parked_world: Prepare, t1: TrialSpec
) -> None:
    """A tool that lags behind is forgiven its lag by robosuite's law, and by Bridge's it is not."""
    ways = {}
    for delta in ("osc", "bridge"):
        step = 0.01 / DELTAS[delta].unit[0] * np.eye(6)[0]
        with Episode(t1, card=card(delta), prepare=parked_world) as episode:
            before = episode.reset().pose_tcp_in_base
            for _ in range(8):
                measured = episode.simulation.encoders.pose_tcp_in_base
                episode.simulation.refresh()
                now = measured(episode.simulation.data)[:3, 3]
                episode.step(Action(delta=-step), observe=False)
                goal = episode.log.arrays()["actions/pose_tcp_in_base"][-1]
                if delta == "osc":
                    np.testing.assert_allclose(goal[:3], now - [0.01, 0, 0], atol=1e-12)
            np.testing.assert_allclose(goal[3:], before[3:], atol=1e-9)
            ways[delta] = before[0] - goal[0]
    assert ways["bridge"] == pytest.approx(0.08, abs=1e-12)
    assert ways["osc"] < 0.06


def test_what_is_recorded_and_executed_again_as_poses(parked_world: Prepare, t1: TrialSpec) -> None:
    deltas = [np.array([-0.2, 0.1, 0.3, 0.05, 0.0, -0.1]), None, np.array([-0.2, 0.1, 0.3, 0.0, 0.0, 0.0])]
    with Episode(t1, card=card("osc"), prepare=parked_world) as episode:
        episode.reset()
        for delta in deltas:
            episode.step(Action(delta=delta, stiffness=(300.0, 20.0)), observe=False)
        episode.step(Action(done=True), observe=False)
        recording = episode.finish()
    given = [np.full(6, np.nan) if delta is None else delta for delta in [*deltas, None]]
    np.testing.assert_array_equal(recording["actions/delta"], given)
    poses = recording["actions/pose_tcp_in_base"]
    np.testing.assert_array_equal(np.isnan(poses).all(axis=1), [False, True, False, True])
    assert (recording["actions/stiffness"] == [300, 20]).all()
    assert score_recording(recording).trial_id
    with Episode(t1, card=card("osc"), prepare=parked_world) as again:
        again.reset()
        again._driver.check = lambda action: None  # type: ignore[union-attr,method-assign]
        for action in recorded_actions(recording):
            again._driver.apply(action, 0.1)  # type: ignore[union-attr]
            again._run(next(again._periods))
    np.testing.assert_array_equal(again.log.arrays()["state/integration"], recording["state/integration"])


@pytest.mark.parametrize("clips", [False, True])
def test_a_target_outside_the_workspace(parked_world: Prepare, t1: TrialSpec, clips: bool) -> None:
    out_of_bounds = "clip" if clips else "error"
    with Episode(t1, card=card("metres-base", out_of_bounds=out_of_bounds), prepare=parked_world) as episode:
        episode.reset()
        high = episode.session.action_bounds.workspace_high_m
        up = Action(delta=np.array([0, 0, 0.15, 0, 0, 0]))
        if not clips:
            episode.step(up, observe=False)
            with pytest.raises(ActionError, match=r"delta: expected a target inside the workspace \[.*0.75\] m in"):
                episode.step(up, observe=False)
            with pytest.raises(ActionError, match=r"-0.25 to 0.25 z in the convention metres-base, got 0.3; Metres"):
                episode.step(Action(delta=np.array([0, 0, 0.3, 0, 0, 0])), observe=False)
            return
        for _ in range(3):
            episode.step(up, observe=False)
        episode.step(Action(delta=np.array([0, 0, -0.5, 0, 0, 0]), done=True), observe=False)
        recording = episode.finish()
    goals = recording["actions/pose_tcp_in_base"]
    assert goals[:3, 2].max() == high[2]
    assert recording["actions/clipped"].tolist() == [0, 1, 1, 1], "inside, twice beyond the border, beyond a bound"
    assert recording["actions/delta"][3][2] == -0.25, "beyond the convention's bound"
    assert goals[3, 2] == pytest.approx(high[2] - 0.25)


def test_the_measured_pose_is_that_after_the_latency_and_of_this_moment(parked_world: Prepare, t1: TrialSpec) -> None:
    """Poses that MuJoCo holds are a physics step old; where a delta begins must not depend on whether anything has
    brought them up to date."""
    late, ran = t1.model_copy(update={"protocol": overridden(t1.protocol, {"phases.latency_s": 0.1})}), []
    for fresh in (False, True):
        with Episode(late, card=card("osc"), prepare=parked_world) as episode:
            episode.reset()
            for _ in range(6):
                episode.step(Action(delta=np.array([-0.5, 0.2, 0.1, 0, 0, 0.1])), observe=False)
                if fresh:
                    episode.simulation.refresh()
            ran.append(episode.log.arrays())
    for name in ("actions/pose_tcp_in_base", "scorer/pose_tcp_in_world"):
        np.testing.assert_array_equal(ran[0][name], ran[1][name])
    # The robot was at rest for the latency, and then moved.
    assert ran[0]["actions/time_s"][0] == pytest.approx(0.1)
