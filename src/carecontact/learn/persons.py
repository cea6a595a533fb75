"""The persons of the training room. Every draw of theirs depends on a public salt, which no run of the exam has, so
that none of them is the person of a seed of the exam."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.errors import ConfigError
from carecontact.protocol.protocol import TRAINING_SALT, TRAINING_SHA256, Protocol, TrialSpec

__all__ = ["TRAINING_SALT", "TRAINING_SHA256", "numbers_of", "training_spec"]


def numbers_of(persons: int | Sequence[int]) -> tuple[int, ...]:
    """Return the numbers of persons: of a count those from 0 on, or those that are given.

    Raises ConfigError if there are none, or if a number is negative or repeated.
    """
    expected = "Bathing.persons: expected a number of persons from 1 on, or different numbers of persons from 0 on"
    if not isinstance(persons, int | Sequence):
        raise ConfigError(f"{expected}; got {persons!r:.80}")
    numbers = tuple(range(persons) if isinstance(persons, int) else persons)
    if not numbers or len(set(numbers)) < len(numbers) or any(type(n) is not int or n < 0 for n in numbers):
        raise ConfigError(f"{expected}; got {persons!r:.80}")
    return numbers


def training_spec(protocol: Protocol, task_id: str, person: int, *, noise_salt: str = "") -> TrialSpec:
    """Return the trial of one person of the training room.

    Args:
        person: number from 0 on; it takes the place of a seed.
        noise_salt: decides the noise of the sensors, where the protocol has any.
    """
    return TrialSpec(
        protocol=protocol,
        task_id=task_id,
        seed=person,
        policy="carecontact.learn",
        salt=TRAINING_SALT,
        noise_salt=noise_salt if protocol.variation.sensor_noise else "",
    )
