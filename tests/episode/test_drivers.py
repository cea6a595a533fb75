"""Episodes of policies that command joints: their world, their recording, their end."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.log import STOPPED_OVER
from carecontact.episode.randomization import World, settled_world
from carecontact.errors import ActionError
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.lab.validation.stability import random_compliance
from carecontact.lab.validation.subject import in_base
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording, canonical_hash
from carecontact.scoring import score_recording
from carecontact.scoring.commanded import target_poses
from carecontact.sim.controllers import CartesianControl

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


# Random legal commands on L3: nothing breaks, and the robot that the recording shows is never fast.

PROTOCOL = load_protocol("bathing-wide-v2", level="L3")
STOP_M_S = STOPPED_OVER * PROTOCOL.physics.max_tcp_speed_m_s
CARD = PolicyCard(name="legal", cameras=(), control_hz=5)
ACTIONS = 25
HARDEST_N_M, HEAVIEST_KG = 75_000.0, 12.0
"""The stiffest spring of ISO/TS 15066:2016 for a part that a tool reaches here (hands and fingers; from secondary
transcriptions), and the robot's largest effective mass at its tool in its parked and working postures. A mass m that a
spring k stops from the speed v adds v sqrt(k m) to what pushes it."""
MOST_N = np.sqrt(3) * PROTOCOL.impedance.force_clamp_n + STOP_M_S * np.sqrt(HARDEST_N_M * HEAVIEST_KG)


def trials(count: int, *, worlds: int, task: str = "T3") -> list[Recording]:
    """Recordings of random legal commands near the target region: poses, and a compliance with each of them."""
    out = []
    for seed in range(worlds):
        simulation, settled, sha256 = settled_world(PROTOCOL, task_id=task, seed=seed)
        begin = simulation.integration_state()
        place = simulation.data.site(f"region_{PROTOCOL.task(task).region}").xpos.copy()

        def prepare(spec: TrialSpec, world: World = (simulation, settled, sha256), begin: np.ndarray = begin) -> World:
            fresh = type(world[0])(world[0].scene)
            fresh.restore(begin, comfort_arm_deg=world[1].comfort_arm_deg)
            fresh.control.park()
            return fresh, world[1], world[2]

        for number in range(count // worlds):
            spec = TrialSpec(protocol=PROTOCOL, task_id=task, seed=seed, policy="legal")
            with Episode(spec, card=CARD, prepare=prepare) as episode:
                out.append(played(episode, place, np.random.default_rng([seed, number])))
    return out


def played(episode: Episode, place: np.ndarray, rng: np.random.Generator) -> Recording:
    episode.reset()
    bounds, reason, given = episode.session.action_bounds, None, 0
    middle = in_base(episode.simulation, place)
    while reason is None:
        stiffness, ratio, wrench = random_compliance(PROTOCOL.impedance, rng)
        at = np.clip(rng.normal(middle, [0.08, 0.08, 0.05]), bounds.workspace_low_m, bounds.workspace_high_m)
        quat = rng.normal([0.0, 1.0, 0.0, 0.0], 0.15)
        pose, last = np.r_[at, quat / np.linalg.norm(quat)], given == ACTIONS
        action = Action(
            pose_tcp_in_base=pose, stiffness=stiffness, damping_ratio=ratio, wrench_in_tcp=wrench, done=last
        )
        reason, given = episode.step(action, observe=False).reason, given + 1
    return episode.finish()


def check(recordings: list[Recording]) -> None:
    for recording in recordings:
        failure, speed = recording.header.failure, recording["scorer/tcp_speed"]
        assert failure is None or failure.kind in ("force", "tool_speed"), failure
        assert all(np.isfinite(values).all() for path, values in recording.arrays.items() if path.startswith("scorer/"))
        assert speed.max() <= 1.05 * STOP_M_S
        assert np.linalg.norm(recording["scorer/force_human_from_robot_in_world"], axis=2).max() <= MOST_N
        assert score_recording(recording).trial_id


def test_random_legal_commands_do_not_make_the_tool_fast() -> None:
    check(trials(2, worlds=1))


def test_without_the_law_a_trial_is_cut_and_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CartesianControl, "_hold_back", lambda self: None)
    recordings = trials(4, worlds=1)
    check(recordings)
    cut = [r for r in recordings if r.header.failure is not None and r.header.failure.kind == "tool_speed"]
    assert len(cut) >= 3
    assert "the robot stops itself above 0.40 m/s" in cut[0].header.failure.message
    score = score_recording(cut[0])
    assert (score.c3_success, score.failure_mode) == (False, "safety_truncation")


@pytest.mark.slow
@pytest.mark.parametrize("task", ["T3", "T5", "T7"])
def test_a_hundred_trials_of_each_region(task: str) -> None:
    recordings = trials(100, worlds=10, task=task)
    check(recordings)
    speed = np.array([r["scorer/tcp_speed"].max() for r in recordings])
    force = [np.linalg.norm(r["scorer/force_human_from_robot_in_world"], axis=2).max() for r in recordings]
    ends = [r.header.failure.kind if r.header.failure else r.header.ended for r in recordings]
    sys.stdout.write(
        f"{task}: tool {np.median(speed):.3f}, {np.quantile(speed, 0.9):.3f}, {speed.max():.3f} m/s, "
        f"largest force {max(force):.0f} N of {MOST_N:.0f}, ends { ({e: ends.count(e) for e in ends}) }\n"
    )
    assert np.mean([end == "tool_speed" for end in ends]) < 0.05


# Actions that say how compliant the tool is: what is in force, what is recorded, what is refused.

COMPLIANCE_CARD = PolicyCard(name="compliant", cameras=(), control_hz=10)
OPTIONAL = {"actions/axis_stiffness", "actions/damping_ratio", "actions/wrench_in_tcp"}
PUSH = np.array([0.0, 0.0, 8.0, 0.0, 0.0, 0.0])
LOOSE_ALONG_Z = (400.0, 400.0, 0.0, 20.0, 20.0, 20.0)


def played_compliantly(prepare: Callable[[TrialSpec], World], spec: TrialSpec, actions: list[Action]) -> Recording:
    with Episode(spec, card=COMPLIANCE_CARD, prepare=prepare) as episode:
        episode.reset()
        for action in [*actions, Action(done=True)]:
            episode.step(action, observe=False)
        return episode.finish()


def moved_along_the_tool(recording: Recording) -> float:
    pose = recording["scorer/pose_tcp_in_world"].astype(float)
    way = pose[-1, :3] - pose[0, :3]
    w, x, y, z = pose[0, 3:]
    return float(way @ [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def test_a_feedforward_moves_the_tool_by_force_over_stiffness(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    pushed = played_compliantly(parked_world, t1, [Action(wrench_in_tcp=PUSH)] + [Action()] * 30)
    assert moved_along_the_tool(pushed) == pytest.approx(8.0 / 400.0, rel=0.02)
    assert set(pushed.arrays) & OPTIONAL == {"actions/wrench_in_tcp"}
    np.testing.assert_array_equal(pushed["actions/wrench_in_tcp"], np.tile(PUSH, (32, 1)))
    assert score_recording(pushed).trial_id


def test_six_stiffnesses_act_axis_by_axis(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    stiff = (400.0, 400.0, 1000.0, 20.0, 20.0, 20.0)
    pushed = played_compliantly(parked_world, t1, [Action(stiffness=stiff, wrench_in_tcp=PUSH)] + [Action()] * 30)
    assert moved_along_the_tool(pushed) == pytest.approx(8.0 / 1000.0, rel=0.03)
    np.testing.assert_array_equal(pushed["actions/axis_stiffness"][-1], stiff)
    np.testing.assert_array_equal(pushed["actions/stiffness"][-1], [1000.0, 20.0])


def test_less_damping_moves_the_tool_sooner(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    early = {
        ratio: moved_along_the_tool(
            played_compliantly(parked_world, t1, [Action(damping_ratio=ratio, wrench_in_tcp=PUSH), Action()])
        )
        for ratio in (0.5, 1.0, 2.0)
    }
    assert early[0.5] > 1.2 * early[1.0] > 1.44 * early[2.0] > 0


def test_an_axis_without_spring_goes_on_as_long_as_the_force_lasts(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    gone = played_compliantly(parked_world, t1, [Action(stiffness=LOOSE_ALONG_Z, wrench_in_tcp=PUSH)] + [Action()] * 8)
    # Damped as at the smallest stiffness: 2 sqrt(100 N/m 10 kg) = 63 N s/m.
    speed = gone["scorer/tcp_speed"][-200:].mean()
    assert 0.5 * 8 / 63.2 < speed < 1.1 * 8 / 63.2


def test_an_axis_with_neither_spring_nor_force_is_refused(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    with Episode(t1, card=COMPLIANCE_CARD, prepare=parked_world) as episode:
        episode.reset()
        with pytest.raises(ActionError, match="stiffness: 0 along z, where no feedforward acts either"):
            episode.step(Action(stiffness=LOOSE_ALONG_Z), observe=False)
        episode.step(Action(stiffness=LOOSE_ALONG_Z, wrench_in_tcp=PUSH), observe=False)
        with pytest.raises(ActionError, match="stiffness: 0 along z, where no feedforward acts either"):
            episode.step(Action(wrench_in_tcp=np.zeros(6)), observe=False)
        episode.step(Action(stiffness=(400.0, 20.0), wrench_in_tcp=np.zeros(6)), observe=False)


def test_a_feedforward_ends_with_its_episode(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    """Episodes may share a compiled scene, and settling steps it before any control period begins."""
    played_compliantly(parked_world, t1, [Action(wrench_in_tcp=PUSH)])
    simulation, *_ = parked_world(t1)
    before = simulation.encoders.joint_position(simulation.data)
    mujoco.mj_step(simulation.model, simulation.data, 50)
    np.testing.assert_allclose(simulation.encoders.joint_position(simulation.data), before, atol=1e-6)


def test_a_pose_policys_recording_has_no_new_array(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    plain = played_compliantly(parked_world, t1, [Action(stiffness=(500.0, 20.0))])
    assert not set(plain.arrays) & (OPTIONAL | {"actions/joint"})
    np.testing.assert_array_equal(plain["actions/stiffness"], [[500.0, 20.0]] * 2)


# A declared latency: the last target holds, the world goes on, and the trial stays reproducible.

LATENCY_CARD = PolicyCard(name="slow", cameras=(), control_hz=10)


def late(spec: TrialSpec, seconds: float) -> TrialSpec:
    return spec.model_copy(update={"protocol": overridden(spec.protocol, {"phases.latency_s": seconds})})


def played_late(prepare: Callable[[TrialSpec], World], spec: TrialSpec) -> Recording:
    with Episode(spec, card=LATENCY_CARD, prepare=prepare) as episode:
        pose = episode.reset().pose_tcp_in_base
        for _ in range(3):
            pose = pose + [0, 0, -0.01, 0, 0, 0, 0]
            episode.step(Action(pose_tcp_in_base=pose), observe=False)
            step = episode.step(Action())
            assert step.observation is not None
        episode.step(Action(done=True), observe=False)
        return episode.finish()


def test_every_answer_begins_later_and_the_actions_of_a_chunk_do_not(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    at_once, later = (played_late(parked_world, spec) for spec in (t1, late(t1, 0.25)))
    assert len(at_once["scorer/time_s"]) == pytest.approx(0.7 / 0.002, abs=2)
    np.testing.assert_allclose(at_once["actions/time_s"], 0.1 * np.arange(7), atol=1e-9)
    np.testing.assert_allclose(
        later["actions/time_s"], 0.1 * np.arange(7) + 0.25 * np.array([1, 1, 2, 2, 3, 3, 4]), atol=1e-9
    )
    np.testing.assert_allclose(later["policy/observation_time_s"], [0.0, 0.45, 0.9, 1.35], atol=1e-9)
    assert score_recording(later).overrides == {"phases.latency_s": "0.25"}
    assert canonical_hash(later) == canonical_hash(played_late(parked_world, late(t1, 0.25)))


def test_the_last_target_holds_meanwhile(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    later = played_late(parked_world, late(t1, 0.25))
    target, period = later["scorer/target_in_base"], later["scorer/period_time_s"]
    np.testing.assert_array_equal(target[period < 0.24], target[:1].repeat((period < 0.24).sum(), axis=0))


def test_a_trial_may_end_while_it_waits(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    protocol = overridden(t1.protocol, {"phases.latency_s": 1.0, "phases.time_limit_s": 0.5})
    with Episode(t1.model_copy(update={"protocol": protocol}), card=LATENCY_CARD, prepare=parked_world) as episode:
        episode.reset()
        step = episode.step(Action())
        assert (step.reason, step.observation) == ("time_limit", None)
        recording = episode.finish()
    assert len(recording["actions/time_s"]) == 0
    assert len(recording["scorer/time_s"]) == 250
