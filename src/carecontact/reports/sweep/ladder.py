"""Success over levels: how far each policy comes from the easiest to the hardest of a plan's protocols."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from carecontact.policies.registry import Role
from carecontact.reports.sweep.persons import Trials, best, of_role, trials_of
from carecontact.stats import PersonDifference, PersonRate, WorstShare, holm

if TYPE_CHECKING:
    from carecontact.reports.sweep.table import CellScores

AXES = ("protocol", "level")


@dataclass(frozen=True, kw_only=True)
class Climb:
    """One policy at one level."""

    policy: str
    role: Role
    rate: PersonRate
    harder: tuple[int, int] | None
    """Trials that pass the harder band, of how many; None where no trial was scored for it."""
    worst: WorstShare
    above_blind: PersonDifference | None
    """Minus the best blind baseline; None for that itself, and where there is none."""
    by_task: dict[str, tuple[int, int]]
    """Task -> passed and all."""


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """Two methods at one level, over the trials that both have."""

    a: str
    b: str
    difference: PersonDifference
    """a minus b."""
    p_holm: float | None
    """Adjusted over all contrasts of all levels."""


@dataclass(frozen=True, kw_only=True)
class Rung:
    value: str
    """The level's name."""
    best_blind: str | None
    climbs: tuple[Climb, ...]
    contrasts: tuple[Contrast, ...]


@dataclass(frozen=True, kw_only=True)
class Ladder:
    rungs: tuple[Rung, ...]
    """The levels in the order of the plan, which should be from easy to hard."""
    policies: tuple[str, ...]
    tasks: tuple[str, ...]

    @property
    def with_trials(self) -> tuple[str, ...]:
        """Return those of ``policies`` that have a trial at any level."""
        ran = {climb.policy for rung in self.rungs for climb in rung.climbs if climb.rate.n}
        return tuple(name for name in self.policies if name in ran)


def ladder(cells: Sequence[CellScores], outcome: str) -> Ladder | None:
    """Return the rates from level to level; None where the plan has one protocol, or where nothing has run.

    Args:
        outcome: field of a score that says whether a trial passed.
    """
    values = levels_of(cells)
    if len(values) < 2 or not any(cell.scores for cell in cells):
        return None
    policies = list(dict.fromkeys(cell.label for cell in cells))
    found = {
        value: {
            name: trials_of((c for c in cells if c.label == name and level_of(c) == value), outcome, without=AXES)
            for name in policies
        }
        for value in values
    }
    methods, pairs = of_role(cells, "method"), list[tuple[str, str, str, PersonDifference]]()
    for value in values:
        for a, b in combinations(methods, 2):
            pairs.append((value, a, b, found[value][a].minus(found[value][b])))
    adjusted = holm([difference.test.pvalue for *_, difference in pairs]).adjusted
    contrasts = [
        (value, Contrast(a=a, b=b, difference=difference, p_holm=p))
        for (value, a, b, difference), p in zip(pairs, adjusted, strict=True)
    ]
    roles: dict[str, Role] = {cell.label: cell.role for cell in cells}
    rungs = [
        _rung(value, found[value], roles, tuple(one for of, one in contrasts if of == value and one.difference.n))
        for value in values
    ]
    tasks = {task for rung in rungs for climb in rung.climbs for task in climb.by_task}
    return Ladder(rungs=tuple(rungs), policies=tuple(policies), tasks=tuple(sorted(tasks)))


def level_of(cell: CellScores) -> str:
    """Return the name of a cell's level as titles have it: the protocol, and its level where it has levels."""
    return " ".join(cell.values[axis] for axis in AXES if axis in cell.values)


def levels_of(cells: Sequence[CellScores]) -> list[str]:
    """Return the names of the levels in the order of the plan."""
    return list(dict.fromkeys(map(level_of, cells)))


def _rung(value: str, trials: Mapping[str, Trials], roles: Mapping[str, Role], contrasts: tuple[Contrast, ...]) -> Rung:
    blind = best({name: one for name, one in trials.items() if roles[name] == "blind"})
    return Rung(
        value=value,
        best_blind=blind,
        climbs=tuple(
            Climb(
                policy=name,
                role=roles[name],
                rate=one.rate,
                harder=one.harder(),
                worst=one.worst,
                above_blind=one.minus(trials[blind]) if blind is not None and name != blind else None,
                by_task=one.by_task(),
            )
            for name, one in trials.items()
        ),
        contrasts=contrasts,
    )
