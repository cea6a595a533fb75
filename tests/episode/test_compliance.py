"""Actions that say how compliant the tool is: what is in force, what is recorded, what is refused."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World
from carecontact.errors import ActionError
from carecontact.recording import Recording
from carecontact.scoring import score_recording

CARD = PolicyCard(name="compliant", cameras=(), control_hz=10)
OPTIONAL = {"actions/axis_stiffness", "actions/damping_ratio", "actions/wrench_in_tcp"}
PUSH = np.array([0.0, 0.0, 8.0, 0.0, 0.0, 0.0])
LOOSE_ALONG_Z = (400.0, 400.0, 0.0, 20.0, 20.0, 20.0)


def played(prepare: Callable[[TrialSpec], World], spec: TrialSpec, actions: list[Action]) -> Recording:
    with Episode(spec, card=CARD, prepare=prepare) as episode:
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
    pushed = played(parked_world, t1, [Action(wrench_in_tcp=PUSH)] + [Action()] * 30)
    assert moved_along_the_tool(pushed) == pytest.approx(8.0 / 400.0, rel=0.02)
    assert set(pushed.arrays) & OPTIONAL == {"actions/wrench_in_tcp"}
    np.testing.assert_array_equal(pushed["actions/wrench_in_tcp"], np.tile(PUSH, (32, 1)))
    assert score_recording(pushed).trial_id


def test_six_stiffnesses_act_axis_by_axis(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    stiff = (400.0, 400.0, 1000.0, 20.0, 20.0, 20.0)
    pushed = played(parked_world, t1, [Action(stiffness=stiff, wrench_in_tcp=PUSH)] + [Action()] * 30)
    assert moved_along_the_tool(pushed) == pytest.approx(8.0 / 1000.0, rel=0.03)
    np.testing.assert_array_equal(pushed["actions/axis_stiffness"][-1], stiff)
    np.testing.assert_array_equal(pushed["actions/stiffness"][-1], [1000.0, 20.0])


def test_less_damping_moves_the_tool_sooner(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    early = {
        ratio: moved_along_the_tool(
            played(parked_world, t1, [Action(damping_ratio=ratio, wrench_in_tcp=PUSH), Action()])
        )
        for ratio in (0.5, 1.0, 2.0)
    }
    assert early[0.5] > 1.2 * early[1.0] > 1.44 * early[2.0] > 0


def test_an_axis_without_spring_goes_on_as_long_as_the_force_lasts(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    gone = played(parked_world, t1, [Action(stiffness=LOOSE_ALONG_Z, wrench_in_tcp=PUSH)] + [Action()] * 8)
    # Damped as at the smallest stiffness: 2 sqrt(100 N/m 10 kg) = 63 N s/m.
    speed = gone["scorer/tcp_speed"][-200:].mean()
    assert 0.5 * 8 / 63.2 < speed < 1.1 * 8 / 63.2


def test_an_axis_with_neither_spring_nor_force_is_refused(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    with Episode(t1, card=CARD, prepare=parked_world) as episode:
        episode.reset()
        with pytest.raises(ActionError, match="stiffness: 0 along z, where no feedforward acts either"):
            episode.step(Action(stiffness=LOOSE_ALONG_Z), observe=False)
        episode.step(Action(stiffness=LOOSE_ALONG_Z, wrench_in_tcp=PUSH), observe=False)
        with pytest.raises(ActionError, match="stiffness: 0 along z, where no feedforward acts either"):
            episode.step(Action(wrench_in_tcp=np.zeros(6)), observe=False)
        episode.step(Action(stiffness=(400.0, 20.0), wrench_in_tcp=np.zeros(6)), observe=False)


def test_a_feedforward_ends_with_its_episode(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    """Episodes may share a compiled scene, and settling steps it before any control period begins."""
    played(parked_world, t1, [Action(wrench_in_tcp=PUSH)])
    simulation, *_ = parked_world(t1)
    before = simulation.encoders.joint_position(simulation.data)
    mujoco.mj_step(simulation.model, simulation.data, 50)
    np.testing.assert_allclose(simulation.encoders.joint_position(simulation.data), before, atol=1e-6)


def test_a_pose_policys_recording_has_no_new_array(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    plain = played(parked_world, t1, [Action(stiffness=(500.0, 20.0))])
    assert not set(plain.arrays) & (OPTIONAL | {"actions/joint"})
    np.testing.assert_array_equal(plain["actions/stiffness"], [[500.0, 20.0]] * 2)
