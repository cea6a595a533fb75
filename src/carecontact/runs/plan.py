"""Trial specs of ``--tasks`` and ``--seeds``, the part of them that one machine runs, and what can be checked
before."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self, TypeVar

from carecontact.errors import ConfigError, UnknownNameError, did_you_mean
from carecontact.protocol.load import load_levels, shipped_protocols
from carecontact.protocol.protocol import TRAINING_SALT, TRAINING_SHA256, Protocol, TrialSpec
from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.contact import rate_faults
from carecontact.scoring.gate_sweep import protocol_sweeps
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.metrics.metric import checked_metrics

logger = logging.getLogger(__name__)

SALT_DIGITS = 32
"""Number of digits, in base 16, of the salt of a run's sensor noise."""


def parse_tasks(text: str, *, protocol: Protocol) -> list[str]:
    """``T1,T2``, ``T1-T7`` (in the protocol's order) or ``all`` -> task ids in the protocol's order."""
    order = [task.id for task in protocol.tasks]
    valid = f"{', '.join(order)}, a range like {order[0]}-{order[-1]}, or all"
    wanted: set[str] = set()
    for part in _parts(text, name="tasks", valid=valid):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if part in order:
            first = last = part
        elif part == "all":
            first, last = order[0], order[-1]
        elif not dash or first not in order or last not in order or order.index(first) > order.index(last):
            meant = did_you_mean(part, order)
            raise ConfigError(f"tasks: {part!r} is not a task of {protocol.name}{meant}; valid: {valid}")
        wanted.update(order[order.index(first) : order.index(last) + 1])
    return [task for task in order if task in wanted]


def parse_seeds(text: str, *, protocol: Protocol) -> list[int]:
    """``3``, ``0-19``, ``0,4,7`` or ``all`` -> seeds in the protocol's order."""
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
    """Plan seed by seed, so that an interrupted run has whole sets of tasks."""
    task_ids = list(tasks)
    alike = {"policy_arguments": dict(arguments or {}), "policy_environment": tuple(environment)}
    return [
        TrialSpec.model_validate({"protocol": protocol, "task_id": task, "seed": seed, "policy": policy, **alike})
        for seed in seeds
        for task in task_ids
    ]


def with_noise_salt(specs: list[TrialSpec], salt: str | None, *, one_of_several: bool) -> list[TrialSpec]:
    """Return the trials with a salt of their sensor noise. ``one_of_several``: other parts of the run need the same."""
    noisy = specs[0].protocol.variation.sensor_noise
    if salt is None:
        if noisy and one_of_several and not specs[0].salt:
            remedy = "give every part the same --noise-salt or --salt-file"
            raise ConfigError(f"--shard: this protocol has sensor noise; {remedy}")
        return specs
    if specs[0].salt:
        raise ConfigError("--noise-salt: --salt-file decides the sensor noise too; leave --noise-salt out")
    if len(salt) != SALT_DIGITS or not set(salt) <= set("0123456789abcdef"):
        raise ConfigError(f"--noise-salt: expected {SALT_DIGITS} hexadecimal digits, as `openssl rand -hex 16` prints")
    if not noisy:
        raise ConfigError("--noise-salt: this protocol has no sensor noise; leave the option out")
    return [spec.model_copy(update={"noise_salt": salt}) for spec in specs]


def check_not_trained_on(trained_on: Sequence[str], specs: Sequence[TrialSpec]) -> None:
    """Raises ConfigError where a policy was trained, as its card says, on a person of these trials."""
    for entry in trained_on:
        if entry == TRAINING_SALT:
            raise ConfigError(f"trained_on: {entry} is the training salt itself; give its sha256, {TRAINING_SHA256}")
        name, colon, seeds = entry.partition(":")
        if colon and name not in shipped_protocols() and name not in {spec.protocol.id for spec in specs}:
            logger.warning(
                "trained_on %s: %s is no shipped protocol, so that its persons cannot be checked", entry, name
            )
        # Protocols that draw alike have the same persons, such as the exam and its DROID form.
        alike = load_levels(name).values() if name in shipped_protocols() else ()
        names = {name, *(protocol.drawn_as for protocol in alike)}
        for spec in specs:
            same = spec.commitment == entry
            if colon and not spec.commitment:
                ranges = [part.partition("-") for part in seeds.split(",")]
                within = any(int(low) <= spec.seed <= int(high or low) for low, _, high in ranges)
                same = within and bool(names & {spec.protocol.id, spec.protocol.drawn_as})
            if same and not spec.trains:
                raise ConfigError(
                    f"{spec.policy} was trained on {entry}, as its card says, and {spec.trial_id} is a trial of such a "
                    "person: what it passes there shows nothing; choose other --seeds or another --salt-file"
                )


def compact(numbers: Iterable[int]) -> str:
    """``[0, 1, 2, 5]`` -> ``0-2, 5``."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if not runs or number != runs[-1][-1] + 1:
            runs.append([])
        runs[-1].append(number)
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def _parts(text: str, *, name: str, valid: str) -> list[str]:
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise ConfigError(f"{name}: {text!r} has an empty entry; valid: {valid}")
    return parts


Cell = TypeVar("Cell")
EXPECTED = "expected I/N with I from 1 to N, for example 2/4 for the second of four parts"


@dataclass(frozen=True, kw_only=True)
class Shard:
    """One part of a run's trials, for machines that share nothing but the command line."""

    index: int
    """Number of the part, from 1 to ``count``."""
    count: int

    @classmethod
    def parse(cls, text: str) -> Self:
        index, slash, count = (part.strip() for part in text.partition("/"))
        if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
            raise ConfigError(f"--shard {text}: {EXPECTED}")
        return cls(index=int(index), count=int(count))

    def of(self, specs: Sequence[TrialSpec]) -> list[TrialSpec]:
        """Return the trials of this part, neighbours in the order of the plan; parts differ by one trial at most."""
        self._check_most(len(specs), "trials")
        begin, end = (len(specs) * k // self.count for k in (self.index - 1, self.index))
        return list(specs[begin:end])

    def every(self, cells: Sequence[Cell]) -> list[Cell]:
        """Return every ``count``-th cell of a sweep: 2/4 has the second, the sixth and so on."""
        self._check_most(len(cells), "cells")
        return list(cells[self.index - 1 :: self.count])

    def _check_most(self, n: int, what: str) -> None:
        if self.count > n:
            raise ConfigError(f"--shard {self.index}/{self.count}: there are {n} {what}; give at most as many parts")


def check_protocol(protocol: Protocol) -> None:
    """Raises ConfigError naming every field that the world or the scorer cannot do; imports no simulator."""
    from carecontact.human.library import load_body

    faults: list[str] = []
    try:
        load_body(protocol.person.body)
    except (ConfigError, UnknownNameError) as error:
        faults.append(f"person.body: {error}")
    faults += rate_faults(protocol)
    if protocol.limits.pack not in LIMIT_PACKS:
        # Its name is written beside every score, where it says whose limits they are.
        faults.append(f"limits.pack: {UnknownNameError(LIMIT_PACKS.kind, protocol.limits.pack, LIMIT_PACKS)}")
    robot, angles = protocol.scene.robot, protocol.scene.parked_joint_rad
    joints = enumerate(zip(angles, robot.joint_low_rad, robot.joint_high_rad, strict=True), start=1)
    faults += [
        f"scene.parked_joint_rad: joint {joint} at {angle:g} is outside the robot's {low:.4f} to {high:.4f}"
        for joint, (angle, low, high) in joints
        if not low <= angle <= high
    ]
    if faults:
        raise ConfigError(f"protocol {protocol.name} cannot run: {'; '.join(faults)}")


def check_rows(protocol: Protocol) -> None:
    """Raises ConfigError for a metric, limit pack or action of the gates that the scorer cannot use."""
    for action in protocol.gates.actions:
        behaviour_of(action, protocol.gates.set)
    protocol_sweeps(protocol)
    checked_metrics()
    list(LIMIT_PACKS.values())
