"""What a trial accepts of a policy can be scored: no action, however odd, makes a trial vanish from the count."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from carecontact.contract.action import ACTION_SPACES, Action
from carecontact.contract.action.spaces.cartesian_pose import DAMPING_RATIO, MAX_FEEDFORWARD_N, MAX_FEEDFORWARD_NM
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World
from carecontact.errors import ActionError
from carecontact.scoring import score_recording

FIELDS = {
    "cartesian_pose": ("pose_tcp_in_base", "stiffness", "damping_ratio", "wrench_in_tcp"),
    "joint_position": ("joint",),
    "droid_joint_velocity": ("joint",),
}


def test_the_fields_drawn_here_are_those_of_the_spaces() -> None:
    assert {name: space.fields for name, space in ACTION_SPACES.items()} == FIELDS


class Draws:
    """Random actions: each optional field is given or not, with values inside, at and beyond its bounds, and zero."""

    def __init__(self, space: str, session: Session, parked: tuple[float, ...], *, seed: int) -> None:
        self.space, self.session, self.rng = space, session, np.random.default_rng(seed)
        self.parked = np.array(parked)

    def action(self) -> Action:
        given = {name: getattr(self, name)() for name in FIELDS[self.space] if self.rng.random() < 0.6}
        return Action(**given, gripper=self.number(0.0, 1.0) if self.rng.random() < 0.2 else None)

    def number(self, low: float, high: float, *, zero: float = 0.1) -> float:
        kind = self.rng.random()
        if kind < zero:
            return 0.0
        if kind < zero + 0.2:
            return float(self.rng.choice([low, high]))
        # The last one is just beyond a bound, as rounding leaves it; a fifth of a per mille of actions are refused.
        if kind > 0.99:
            return float(np.nextafter(high, np.inf))
        return float(self.rng.uniform(low, high))

    def pose_tcp_in_base(self) -> np.ndarray:
        low, high = self.session.action_bounds.workspace_low_m, self.session.action_bounds.workspace_high_m
        quat = self.rng.normal(size=4)
        near = np.array([0.5, 0.0, 0.3]) + self.rng.normal(0.0, 0.15, 3)
        far = [self.number(a, b, zero=0.0) for a, b in zip(low, high, strict=True)]
        place = np.clip(near, low, high) if self.rng.random() < 0.7 else np.array(far)
        return np.concatenate([place, quat / np.linalg.norm(quat)])

    def stiffness(self) -> tuple[float, ...]:
        bounds = self.session.action_bounds
        pairs = (bounds.translational_stiffness, bounds.rotational_stiffness)
        if self.rng.random() < 0.4:
            return tuple(self.number(*pair, zero=0.0) for pair in pairs)
        limp = self.rng.random()
        return tuple(self.number(*pair, zero=limp) for pair in pairs for _ in range(3))

    def damping_ratio(self) -> float:
        return self.number(*DAMPING_RATIO, zero=0.0)

    def wrench_in_tcp(self) -> np.ndarray:
        most = [MAX_FEEDFORWARD_N] * 3 + [MAX_FEEDFORWARD_NM] * 3
        return np.array([self.number(-m, m) * self.rng.choice([1.0, 1e-3]) for m in most])

    def joint(self) -> np.ndarray:
        if self.space == "droid_joint_velocity":
            return self.rng.normal(0.0, 3.0, 7)
        low, high = np.array(self.session.joint_low_rad), np.array(self.session.joint_high_rad)
        # A far target ends the trial by the speed of a joint, so that most are near where the robot stands.
        if self.rng.random() < 0.98:
            return np.clip(self.parked + self.rng.normal(0.0, 0.02, 7), low, high)
        return np.array([self.number(*pair, zero=0.0) for pair in zip(low, high, strict=True)])


@pytest.mark.parametrize("draws", [150, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("space", list(FIELDS))
def test_a_random_action_is_refused_or_scored(
    space: str, draws: int, parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    control = "droid" if ACTION_SPACES[space].in_joints else "cartesian-impedance"
    card = PolicyCard(name="draws", cameras=(), control_hz=50, action_space=space, control=control)
    accepted = refused = episodes = 0
    ends = set[str]()
    while accepted + refused < draws:
        with Episode(t1, card=card, prepare=parked_world) as episode:
            episode.reset()
            source = Draws(space, episode.session, t1.protocol.scene.parked_joint_rad, seed=episodes)
            reason = None
            while reason is None and accepted + refused < draws:
                action = source.action()
                try:
                    reason = episode.step(action, observe=False).reason
                    accepted += 1
                except ActionError:
                    refused += 1
            if reason is None:
                reason = episode.step(Action(done=True), observe=False).reason
            score = score_recording(episode.finish())
        assert score.ended == reason
        assert score.is_judged
        ends.add(str(reason))
        episodes += 1
    assert accepted > draws / 3
    assert ends <= {"done", "time_limit", "safety_truncation"}


def limp(**given: object) -> Action:
    return Action(stiffness=(0, 0, 0, 20, 20, 20), wrench_in_tcp=np.array([1e-3, 1e-3, 1e-3, 0, 0, 0]), **given)


def test_a_limp_hand_is_a_failed_trial_and_not_a_lost_one(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    card = PolicyCard(name="limp", cameras=(), control_hz=15)
    with Episode(t1, card=card, prepare=parked_world) as episode:
        episode.reset()
        episode.step(limp(), observe=False)
        episode.step(limp(done=True), observe=False)
        recording = episode.finish()
    np.testing.assert_array_equal(recording["actions/stiffness"], [[0, 20], [0, 20]])
    score = score_recording(recording)
    assert (score.c3_success, score.failure_mode) == (False, "no_target_contact")


def test_a_joint_that_is_too_fast_is_a_failed_trial_and_not_a_lost_one(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    card = PolicyCard(name="fast", cameras=(), control_hz=15, action_space="joint_position", control="droid-sim-evals")
    with Episode(t1, card=card, prepare=parked_world) as episode:
        episode.reset()
        step = episode.step(Action(joint=np.array(episode.session.joint_low_rad) * 0.99), observe=False)
        while step.reason is None:
            step = episode.step(Action(), observe=False)
        recording = episode.finish()
    assert recording.header.failure is not None
    assert recording.header.failure.kind == "joint_speed"
    assert score_recording(recording).failure_mode == "safety_truncation"
