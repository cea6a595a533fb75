from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.trial import TrialSpec
from carecontact.hosting.process import PolicyProcess
from carecontact.hosting.setup import PolicySetup
from carecontact.policies.state_machine.policy import StateMachine
from carecontact.protocols import load_protocol
from carecontact.recording import canonical_hash
from carecontact.trials.trial import run_trial
from tests.policies.synthetic import SESSION, synthetic_observation

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def test_the_readme_shows_the_example() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks == [(EXAMPLES / "my_policy.py").read_text()]


def test_the_own_loop_makes_the_recording_of_a_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    loop, my_policy = (importlib.import_module(name) for name in ("own_loop", "my_policy"))
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="my_policy:MyPolicy")
    mine = loop.run(spec, my_policy.MyPolicy())
    trial = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(EXAMPLES)]))
    assert canonical_hash(mine) == canonical_hash(trial)


def test_my_policy_raises_the_tool_and_ends() -> None:
    observation = synthetic_observation()
    with PolicyProcess(
        PolicySetup.of("my_policy:MyPolicy", search_path=[str(EXAMPLES)]), first_deadline_s=20, deadline_s=20
    ) as process:
        process.start()
        process.reset("gently touch the right forearm", SESSION)
        *moves, end = process.act(observation).actions
    rise = np.array([move.pose_tcp_in_base for move in moves]) - observation.pose_tcp_in_base
    np.testing.assert_allclose(rise[:, 2], 0.005 * np.arange(1, 11), atol=1e-12)
    np.testing.assert_allclose(np.delete(rise, 2, axis=1), 0, atol=1e-12)
    assert end.done


def test_press_deeper_lowers_the_state_machines_targets_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    pose = np.array([0.5, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0])
    plan = [*[Action(pose_tcp_in_base=pose)] * 12, Action(done=True)]
    monkeypatch.setattr(StateMachine, "act", lambda self, observation: plan)
    policy = importlib.import_module("press_deeper").PressDeeper(by_m=0.006)
    *moves, end = policy.act(synthetic_observation())
    lowered = pose - np.array([move.pose_tcp_in_base for move in moves])
    np.testing.assert_allclose(lowered[:, 2], 0.0006 * np.minimum(np.arange(1, 13), 10), atol=1e-12)
    np.testing.assert_allclose(np.delete(lowered, 2, axis=1), 0, atol=1e-12)
    assert end.done
    assert policy.card.name == "press-deeper"
