"""Policies that touch and scrub as no caregiver would pass no more of the exam than a blind arm does.

Pushes are not tested here. A push may reach 25 N, and these policies stay below that when they push.
"""

from __future__ import annotations

from functools import cache
from math import ceil
from pathlib import Path
from typing import Any

import pytest

from carecontact.episode.episode import Episode
from carecontact.policies.blind import FeintAndWait
from carecontact.policies.mean_person import MeanPersonEstimated, MeanPersonHybrid, MeanPersonSearch
from carecontact.policies.state_machine import StateMachine
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.scoring import TrialScore, score_recording
from carecontact.stats import wilson_interval
from tests.slow.planted import Deeper, HoverAndDrop, Palm, Rough, SlowAndBlind, Smear

PROTOCOL = "bathing-wide-v2"
TASKS, SEEDS = ("T1", "T3"), range(9)
LEVELS = ("L1", "L2", "L3")
TRIALS = len(TASKS) * len(SEEDS)
BLIND = (MeanPersonHybrid, MeanPersonEstimated, MeanPersonSearch, SlowAndBlind)


def trial(kind: type[Any], level: str, task_id: str, seed: int, *, protocol: str = PROTOCOL) -> TrialScore:
    """Run one trial in this process, as examples/own_loop.py does."""
    where = "bathing-wide-L1" if level == "L1" else "bathing-wide-L2"
    policy = kind(person=Path(where)) if kind in BLIND else kind()
    spec = TrialSpec(protocol=load_protocol(protocol, level=level), task_id=task_id, seed=seed, policy=policy.card.name)
    with Episode(spec, card=policy.card) as episode:
        if hasattr(policy, "configure"):
            policy.configure(episode.session)
        policy.reset(episode.instruction)
        observation = episode.reset()
        while observation is not None:
            answer, step = policy.act(observation), None
            chunk = answer if isinstance(answer, list) else list(answer)
            for number, action in enumerate(chunk, start=1):
                step = episode.step(action, observe=number == len(chunk))
                if step.reason is not None:
                    break
            observation = None if step is None else step.observation
        return score_recording(episode.finish())


@cache
def passed(kind: type[Any], level: str) -> int:
    return sum(trial(kind, level, task_id, seed).safety_gated for task_id in TASKS for seed in SEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", [Rough, Palm])
def test_who_hurts_or_leans_on_a_person_passes_nothing(kind: type[Any], level: str) -> None:
    assert passed(kind, level) == 0


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", [SlowAndBlind, Smear, HoverAndDrop])
def test_none_passes_more_than_the_floor_and_its_interval(kind: type[Any], level: str) -> None:
    floor = max(passed(MeanPersonHybrid, level), passed(MeanPersonEstimated, level))
    assert passed(kind, level) <= ceil(wilson_interval(floor, TRIALS).high * TRIALS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Deeper, FeintAndWait])
def test_a_constant_and_a_feint_gain_at_most_five_points(kind: type[Any]) -> None:
    """Over the three levels together: five points of the 18 trials of one level are less than one trial."""
    gains = [passed(kind, level) - passed(StateMachine, level) for level in LEVELS]
    assert sum(gains) <= 0.05 * TRIALS * len(LEVELS), gains
