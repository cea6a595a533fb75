"""Episodes of policies that command joints: their world, their recording, their end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np

from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World
from carecontact.scoring import score_recording
from carecontact.scoring.attribution.commanded import target_poses

VELOCITY = PolicyCard(name="v", cameras=(), control_hz=15, action_space="droid_joint_velocity", control="droid")
POSITION = PolicyCard(name="q", cameras=(), control_hz=15, action_space="joint_position", control="droid-sim-evals")


def test_velocities_start_from_the_measured_angles_and_are_scaled_as_a_vector(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    with Episode(t1, card=VELOCITY, prepare=parked_world) as episode:
        observation = episode.reset()
        v = np.array([2.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
        for _ in range(3):
            before = episode.simulation.encoders.joint_position(episode.simulation.data)
            episode.step(Action(joint=v), observe=False)
            np.testing.assert_array_equal(episode.simulation.control._target, before + 0.2 * v / 2)
        episode.step(Action(done=True), observe=False)
        recording = episode.finish()
    assert recording.header.control == "droid"
    np.testing.assert_array_equal(recording["actions/joint"], [v, v, v, np.full(7, np.nan)])
    assert np.isnan(recording["actions/pose_tcp_in_base"]).all()
    assert observation.joint_position[0] == t1.protocol.scene.parked_joint_rad[0]
    assert score_recording(recording).trial_id


def test_the_same_world_goes_on_under_another_control(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    with (
        Episode(t1, card=POSITION, prepare=parked_world) as episode,
        Episode(t1, card=PolicyCard(name="p", cameras=(), control_hz=15), prepare=parked_world) as other,
    ):
        one, two = episode.reset(), other.reset()
        np.testing.assert_array_equal(one.joint_position, two.joint_position)
        np.testing.assert_array_equal(one.pose_tcp_in_base, two.pose_tcp_in_base)
        for _ in range(10):
            episode.step(Action(), observe=False)
            other.step(Action(), observe=False)
        # At rest no control does anything, so both worlds are at the same place.
        np.testing.assert_allclose(episode.simulation.data.qpos, other.simulation.data.qpos, atol=1e-9)
        episode.step(Action(done=True), observe=False)
        other.step(Action(done=True), observe=False)
        hashes = [e.finish().header.sha256["model"] for e in (episode, other)]
    assert hashes[0] != hashes[1]


def test_targets_are_recorded_as_poses_of_the_tool(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    goal = np.array(t1.protocol.scene.parked_joint_rad) + 0.03
    with Episode(t1, card=POSITION, prepare=parked_world) as episode:
        episode.reset()
        episode.step(Action(), observe=False)
        for _ in range(45):
            episode.step(Action(joint=goal), observe=False)
        reached = episode.simulation.encoders.pose_tcp_in_base(episode.simulation.data)[:3, 3]
        episode.step(Action(done=True), observe=False)
        recording = episode.finish()
    np.testing.assert_allclose(recording["scorer/target_in_base"][-1, :3], reached, atol=2e-3)
    poses = target_poses(recording)
    assert np.isnan(poses[0]).all()
    np.testing.assert_allclose(poses[1:46, :3], np.tile(recording["scorer/target_in_base"][-1, :3], (45, 1)), atol=1e-6)


def test_a_joint_that_is_too_fast_ends_the_trial_as_the_robot_would(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    goal = np.array(t1.protocol.scene.parked_joint_rad)
    goal[0] -= 2.5
    card = PolicyCard(name="q", cameras=(), control_hz=15, action_space="joint_position", control="droid")
    with Episode(t1, card=card, prepare=parked_world) as episode:
        episode.reset()
        reason = None
        while reason is None:
            reason = episode.step(Action(joint=goal), observe=False).reason
        failure = episode.finish().header.failure
    assert reason == "safety_truncation"
    assert failure is not None
    assert failure.kind == "joint_speed"
    assert "joint 1 moved at" in failure.message


def test_python_runs_once_a_target_period(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    calls: list[int] = []
    step: Any = mujoco.mj_step

    def counted(model: Any, data: Any, nstep: int = 1) -> None:
        calls.append(nstep)
        step(model, data, nstep)

    with Episode(t1, card=VELOCITY, prepare=parked_world) as episode:
        episode.reset()
        with patch("mujoco.mj_step", counted):
            episode.step(Action(joint=np.full(7, 0.1)), observe=False)
    assert calls == [10, 10, 10, 3]
