"""The options --task and --seed of commands that look at one trial."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carecontact.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from carecontact.contract.protocol import Protocol


def check_trial(rules: Protocol, *, task: str, seed: int) -> None:
    """Check the options. Raises ConfigError for a task or seed that the protocol does not have."""
    ids = [row.id for row in rules.tasks]
    if task not in ids:
        meant = did_you_mean(task, ids)
        raise ConfigError(f"--task: {task!r} is not a task of {rules.id}{meant}; valid: {', '.join(ids)}")
    check_seed(rules, seed=seed)


def check_seed(rules: Protocol, *, seed: int) -> None:
    """Check the option. Raises ConfigError for a seed that the protocol does not have."""
    from carecontact.runs.plan import compact

    if seed not in rules.randomization.seeds:
        raise ConfigError(f"--seed: {seed} is not a seed of {rules.id}; valid: {compact(rules.randomization.seeds)}")
