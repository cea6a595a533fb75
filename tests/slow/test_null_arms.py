"""What cannot do a task passes no gate in simulation; what does not look fails where the person lies elsewhere."""

from __future__ import annotations

import pytest

from carecontact.contract.trial import TrialSpec
from carecontact.protocols import load_protocol
from carecontact.scoring import TrialScore, score_recording
from carecontact.trials.trial import run_trial

pytestmark = pytest.mark.slow
LEVEL = load_protocol("bathing-wide-v2-draft", level="L1")


def run(policy: str, task_id: str, seed: int) -> TrialScore:
    spec = TrialSpec(protocol=LEVEL, task_id=task_id, seed=seed, policy=policy)
    return score_recording(run_trial(spec))


@pytest.mark.parametrize("task_id", [task.id for task in LEVEL.tasks])
@pytest.mark.parametrize("policy", ["zero-action", "hover"])
def test_arms_that_never_touch_pass_no_gate(policy: str, task_id: str) -> None:
    score = run(policy, task_id, 1)
    assert score.ended in ("done", "time_limit")
    assert not score.c3_success
    assert score.peak_force_n == {}


def test_another_person_needs_eyes() -> None:
    assert run("state-machine", "T4", 10).safety_gated
    assert not run("replay", "T4", 10).c3_success
