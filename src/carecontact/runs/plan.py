"""Makes trial specs of ``--tasks`` and ``--seeds``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError, did_you_mean

SALT_DIGITS = 32
"""Number of digits, in base 16, of the salt of a run's sensor noise."""


def parse_tasks(text: str, *, protocol: Protocol) -> list[str]:
    """``T1,T2``, ``T1-T7`` (in the protocol's order) or ``all`` -> task ids in the protocol's order.

    Raises ConfigError listing the protocol's tasks.
    """
    order = [task.id for task in protocol.tasks]
    wanted: set[str] = set()
    for part in _parts(text, name="tasks", valid=f"{', '.join(order)}, a range like {order[0]}-{order[-1]}, or all"):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if part == "all":
            wanted.update(order)
        elif part in order:
            wanted.add(part)
        elif dash and first in order and last in order and order.index(first) <= order.index(last):
            wanted.update(order[order.index(first) : order.index(last) + 1])
        else:
            raise ConfigError(
                f"tasks: {part!r} is not a task of {protocol.name}{did_you_mean(part, order)}; valid: "
                f"{', '.join(order)}, a range like {order[0]}-{order[-1]}, or all"
            )
    return [task for task in order if task in wanted]


def parse_seeds(text: str, *, protocol: Protocol) -> list[int]:
    """``3``, ``0-19``, ``0,4,7`` or ``all`` -> seeds in the protocol's order.

    Raises ConfigError for what is not a number and for seeds that the protocol does not have, naming those it has.
    """
    order = protocol.randomization.seeds
    valid = f"{compact(order)}, as a list (0,4,7), a range (0-19), or all"
    wanted: set[int] = set()
    for part in _parts(text, name="seeds", valid=valid):
        if part == "all":
            wanted.update(order)
            continue
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ConfigError(f"seeds: cannot read {part!r}; valid: {valid}")
        low, high = int(first), int(last) if dash else int(first)
        if low > high:
            raise ConfigError(f"seeds: the range {part!r} runs backwards; valid: {valid}")
        known = {seed for seed in order if low <= seed <= high}
        if len(known) != high - low + 1:
            raise ConfigError(f"seeds: {part!r} contains seeds that {protocol.name} does not have; valid: {valid}")
        wanted.update(known)
    return [seed for seed in order if seed in wanted]


def plan_trials(
    *,
    protocol: Protocol,
    policy: str,
    tasks: Iterable[str],
    seeds: Iterable[int],
    arguments: Mapping[str, str] | None = None,
    environment: Iterable[str] = (),
) -> list[TrialSpec]:
    """Plan seed by seed, so that an interrupted run has whole sets of tasks.

    Args:
        policy: text of its ``PolicyRef``.
        arguments, environment: what --policy-arg gives and the names that --policy-env lets pass.
    """
    task_ids = list(tasks)
    alike = {"policy_arguments": dict(arguments or {}), "policy_environment": tuple(environment)}
    return [
        TrialSpec.model_validate({"protocol": protocol, "task_id": task, "seed": seed, "policy": policy, **alike})
        for seed in seeds
        for task in task_ids
    ]


def with_noise_salt(specs: list[TrialSpec], salt: str | None, *, one_of_several: bool) -> list[TrialSpec]:
    """Return the trials with the salt of their sensor noise, where their protocol has any and a salt is given.

    Args:
        one_of_several: whether the trials are a part of a run, whose other parts need the same salt.

    Raises ConfigError for what is no salt, for one where there is no noise, and where a part has none.
    """
    noisy = specs[0].protocol.variation.sensor_noise
    if specs[0].salt:
        if salt is not None:
            raise ConfigError("--noise-salt: --salt-file decides the sensor noise too; leave --noise-salt out")
        return specs
    if salt is None:
        if noisy and one_of_several:
            raise ConfigError(
                "--shard: this protocol has sensor noise; give every part the same --noise-salt or --salt-file"
            )
        return specs
    if len(salt) != SALT_DIGITS or not set(salt) <= set("0123456789abcdef"):
        raise ConfigError(f"--noise-salt: expected {SALT_DIGITS} hexadecimal digits, as `openssl rand -hex 16` prints")
    if not noisy:
        raise ConfigError("--noise-salt: this protocol has no sensor noise; leave the option out")
    return [spec.model_copy(update={"noise_salt": salt}) for spec in specs]


def compact(numbers: Iterable[int]) -> str:
    """``[0, 1, 2, 5]`` -> ``0-2, 5``."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def _parts(text: str, *, name: str, valid: str) -> list[str]:
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise ConfigError(f"{name}: {text!r} has an empty entry; valid: {valid}")
    return parts
