"""A declared latency: the last target holds, the world goes on, and the trial stays reproducible."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World
from carecontact.protocols import overridden
from carecontact.recording import Recording, canonical_hash
from carecontact.scoring import score_recording

CARD = PolicyCard(name="slow", cameras=(), control_hz=10)


def late(spec: TrialSpec, seconds: float) -> TrialSpec:
    return spec.model_copy(update={"protocol": overridden(spec.protocol, {"phases.latency_s": seconds})})


def played(prepare: Callable[[TrialSpec], World], spec: TrialSpec) -> Recording:
    with Episode(spec, card=CARD, prepare=prepare) as episode:
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
    at_once, later = (played(parked_world, spec) for spec in (t1, late(t1, 0.25)))
    assert len(at_once["scorer/time_s"]) == pytest.approx(0.7 / 0.002, abs=2)
    np.testing.assert_allclose(at_once["actions/time_s"], 0.1 * np.arange(7), atol=1e-9)
    np.testing.assert_allclose(
        later["actions/time_s"], 0.1 * np.arange(7) + 0.25 * np.array([1, 1, 2, 2, 3, 3, 4]), atol=1e-9
    )
    np.testing.assert_allclose(later["policy/observation_time_s"], [0.0, 0.45, 0.9, 1.35], atol=1e-9)
    assert score_recording(later).overrides == {"phases.latency_s": "0.25"}
    assert canonical_hash(later) == canonical_hash(played(parked_world, late(t1, 0.25)))


def test_the_last_target_holds_meanwhile(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    later = played(parked_world, late(t1, 0.25))
    target, period = later["scorer/target_in_base"], later["scorer/period_time_s"]
    np.testing.assert_array_equal(target[period < 0.24], target[:1].repeat((period < 0.24).sum(), axis=0))


def test_a_trial_may_end_while_it_waits(parked_world: Callable[[TrialSpec], World], t1: TrialSpec) -> None:
    protocol = overridden(t1.protocol, {"phases.latency_s": 1.0, "phases.time_limit_s": 0.5})
    with Episode(t1.model_copy(update={"protocol": protocol}), card=CARD, prepare=parked_world) as episode:
        episode.reset()
        step = episode.step(Action())
        assert (step.reason, step.observation) == ("time_limit", None)
        recording = episode.finish()
    assert len(recording["actions/time_s"]) == 0
    assert len(recording["scorer/time_s"]) == 250
