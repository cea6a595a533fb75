from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.oracle.policy import AGAIN, Oracle
from carecontact.protocols import load_protocol
from carecontact.sim.simulation import Simulation
from tests.policies.synthetic import BOUNDS, synthetic_observation


class Ends:
    """A motion of one period."""

    ended = True

    def __init__(self, succeeded: bool) -> None:
        self.succeeded = succeeded

    def act(self) -> Action:
        return Action(pose_tcp_in_base=np.array([9.0, 0, 0.4, 0, 1, 0, 0]))


@pytest.mark.parametrize(("succeeded", "share", "done"), [(True, 0.1, True), (False, 0.1, False), (False, 0.9, True)])
def test_a_motion_that_lost_the_person_is_planned_again_while_there_is_time(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, succeeded: bool, share: float, done: bool
) -> None:
    planned: list[object] = []
    monkeypatch.setattr(Oracle, "_planned", lambda self, start: planned.append(start) or Ends(succeeded))
    oracle = Oracle(simulation, load_protocol().task("T1"), BOUNDS)
    seen = replace(synthetic_observation(), sim_time_s=share * simulation.protocol.phases.time_limit_s)
    first = oracle.act(seen)
    assert first.done is done
    assert first.pose_tcp_in_base is not None
    assert first.pose_tcp_in_base[0] == BOUNDS.workspace_high_m[0], "targets stay in the workspace"
    if not done:
        oracle.act(seen)
    assert len(planned) == (1 if done else 2)
    assert 0.1 < AGAIN < 0.9


def test_a_region_that_it_does_not_know_ends_the_trial_untouched(simulation: Simulation) -> None:
    task = load_protocol().task("T1").model_copy(update={"region": "left_shank"})
    oracle = Oracle(simulation, task, BOUNDS)
    assert oracle.act(synthetic_observation()).done
    assert "left_shank" in str(oracle.take_notes()["ended_without_touching"])
