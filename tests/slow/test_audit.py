"""The whole audit on the level where a policy must not know most: every card of its own, the policies' trials to their
end."""

from __future__ import annotations

import pytest

from carecontact.audit.run import audit
from carecontact.hosting.setup import PolicySetup
from carecontact.policies.registry import POLICIES, role_of
from carecontact.protocols import load_protocol

pytestmark = pytest.mark.slow


def test_no_part_finds_a_leak() -> None:
    policies = [PolicySetup.of(name) for name in POLICIES if role_of(name) != "privileged"]
    tasks = ["T1", "T3", "T6"]
    result = audit(load_protocol("bathing-wide-v2-draft", level="L3"), policies, quick=False, tasks=tasks, seed=3)
    assert [(part.name, part.findings, part.missing) for part in result.parts if not part.passed] == []
    assert {(trial.policy, trial.task_id) for trial in result.trials} == {
        (policy.ref.text, task) for policy in policies for task in tasks
    }
    assert [trial.error for trial in result.trials if trial.error or not trial.kept] == []
    counts = {part.name: part.counts for part in result.parts}
    assert counts["re-derivation"]["observations in contact"] >= 2 * 4 * 3
