"""What the levels and factors of a sweep do to the rates of policies, and to their order."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from carecontact.policies.registry import Role
from carecontact.report.overview import REFERENCE, rank
from carecontact.report.paired import bodies
from carecontact.runs.pooling import judged
from carecontact.runs.sweep import ALL, AXIS, NONE, only_factor, without_factor
from carecontact.scoring.result import TrialScore
from carecontact.stats import (
    PersonDifference,
    PersonRate,
    WorstShare,
    holm,
    person_difference,
    person_rate,
    worst_share,
)

if TYPE_CHECKING:
    from carecontact.report.sweep_table import CellScores


Key = tuple[Hashable, str, int]
"""Place without the values that are compared, task and seed."""


@dataclass(frozen=True, kw_only=True)
class Trials:
    """What one policy did in some cells."""

    scores: Mapping[Key, TrialScore]
    outcome: str
    """Field of a score that says whether a trial passed."""

    def passed(self, key: Key) -> bool:
        return bool(getattr(self.scores[key], self.outcome))

    @property
    def rate(self) -> PersonRate:
        keys = list(self.scores)
        return person_rate(list(map(self.passed, keys)), persons=[key[2] for key in keys], strata=self.strata)

    @property
    def strata(self) -> dict[int, Hashable]:
        """Person -> stratum."""
        return bodies(self.scores.values())

    @property
    def worst(self) -> WorstShare:
        keys = list(self.scores)
        return worst_share(
            list(map(self.passed, keys)),
            persons=[key[2] for key in keys],
            tasks=[key[:2] for key in keys],
            strata=self.strata,
        )

    def minus(self, other: Trials) -> PersonDifference:
        """Return the difference over the trials that both have."""
        keys = sorted(self.scores.keys() & other.scores.keys(), key=str)
        return person_difference(
            list(map(self.passed, keys)),
            list(map(other.passed, keys)),
            persons=[key[2] for key in keys],
            strata=bodies([*self.scores.values(), *other.scores.values()]),
        )

    def by_task(self) -> dict[str, tuple[int, int]]:
        """Task -> passed and all."""
        found: dict[str, tuple[int, int]] = {}
        for key in self.scores:
            k, n = found.get(key[1], (0, 0))
            found[key[1]] = k + self.passed(key), n + 1
        return dict(sorted(found.items()))

    def harder(self) -> tuple[int, int] | None:
        """Return trials in the harder band, of those for which it is known; None where it is for none."""
        known = [v for s in self.scores.values() if (v := s.additional.get("harder_band@2")) is not None]
        return (sum(value > 0 for value in known), len(known)) if known else None


def trials_of(cells: Iterable[CellScores], outcome: str, *, without: Sequence[str]) -> Trials:
    """``without``: the axes that the cells differ in and that are compared; they are left out of the keys."""
    found: dict[Key, TrialScore] = {}
    for cell in cells:
        place = tuple((axis, value) for axis, value in cell.values.items() if axis not in without)
        for score in judged(cell.scores):
            found[place, score.task_id, score.seed] = score
    return Trials(scores=found, outcome=outcome)


def best(trials: Mapping[str, Trials]) -> str | None:
    """Name of the policy that passes most often; the first of equal ones. None without any trial."""
    shares = {name: one.rate.estimate for name, one in trials.items() if one.scores}
    return max(shares, key=lambda name: shares[name] or 0.0, default=None)


def of_role(cells: Sequence[CellScores], *roles: Role) -> list[str]:
    """Return policies of these roles, in the order of the plan."""
    return list(dict.fromkeys(cell.label for cell in cells if cell.role in roles))


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
    """Return the rates from level to level; None where the plan has one protocol, or where nothing has run."""
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
    pairs = [(value, a, b) for value in values for a, b in combinations(of_role(cells, "method"), 2)]
    differences = [found[value][a].minus(found[value][b]) for value, a, b in pairs]
    adjusted = holm([difference.test.pvalue for difference in differences]).adjusted
    contrasts = [
        (value, Contrast(a=a, b=b, difference=difference, p_holm=p))
        for (value, a, b), difference, p in zip(pairs, differences, adjusted, strict=True)
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


@dataclass(frozen=True, kw_only=True)
class Effect:
    """What one factor does to one policy."""

    factor: str
    policy: str
    alone: PersonRate
    """Rate on the easy level with this factor alone."""
    costs: PersonDifference
    """The rate with the factor alone minus the rate on the easy level: below 0 where the factor alone breaks the
    policy."""
    costs_p_holm: float | None
    without: PersonRate
    """Rate on the hard level without this factor."""
    gives_back: PersonDifference
    """The rate without the factor minus the rate on the hard level: above 0 where the policy fails because of the
    factor."""
    gives_back_p_holm: float | None


@dataclass(frozen=True, kw_only=True)
class Factors:
    low: dict[str, PersonRate]
    """Policy -> rate on the easy level."""
    high: dict[str, PersonRate]
    effects: tuple[Effect, ...]
    """Policy by policy, in the order of the plan. The p-values are adjusted over all of them, both kinds together."""


def factors(cells: Sequence[CellScores], outcome: str) -> Factors | None:
    """Return what each factor costs and gives back; None where no factors are switched, or where nothing has run."""
    if not any(AXIS in cell.values and cell.scores for cell in cells):
        return None
    policies = list(dict.fromkeys(cell.label for cell in cells))
    found = {
        (name, value): trials_of(
            (c for c in cells if c.label == name and c.values[AXIS] == value), outcome, without=(AXIS,)
        )
        for name in policies
        for value in dict.fromkeys(cell.values[AXIS] for cell in cells)
    }
    only = only_factor("")
    names = dict.fromkeys(value.removeprefix(only) for _, value in found if value.startswith(only))
    rows = [(name, factor) for name in policies for factor in names]
    costs = [found[name, only_factor(factor)].minus(found[name, NONE]) for name, factor in rows]
    gains = [found[name, without_factor(factor)].minus(found[name, ALL]) for name, factor in rows]
    adjusted = holm([one.test.pvalue for one in (*costs, *gains)]).adjusted
    return Factors(
        low={name: found[name, NONE].rate for name in policies},
        high={name: found[name, ALL].rate for name in policies},
        effects=tuple(
            Effect(
                factor=factor,
                policy=name,
                alone=found[name, only_factor(factor)].rate,
                costs=costs[row],
                costs_p_holm=adjusted[row],
                without=found[name, without_factor(factor)].rate,
                gives_back=gains[row],
                gives_back_p_holm=adjusted[len(rows) + row],
            )
            for row, (name, factor) in enumerate(rows)
        ),
    )


EVERYWHERE = "over all"


@dataclass(frozen=True, kw_only=True)
class GateOrder:
    place: str
    """A level, or EVERYWHERE."""
    gate: str
    """Name of the swept gate, ``gamma``, or a step of the funnel."""
    least: float | None
    """Smallest Kendall's tau-b with the order under the protocol's own gates; None where one of them orders nothing."""
    setting: str
    """The gate and its value at which that is so."""


def gate_orders(cells: Sequence[CellScores], policies: Sequence[str]) -> tuple[GateOrder, ...]:
    """Return how each swept gate orders the policies; none with fewer than two policies. A trial counts where every
    policy has it."""
    if len(policies) < 2:
        return ()
    values = levels_of(cells)
    places = {value: [c for c in cells if level_of(c) == value] for value in values if len(values) > 1}
    found: list[GateOrder] = []
    for place, of_place in ({EVERYWHERE: list(cells)} | places).items():
        methods = _common(of_place, policies)
        if all(methods.values()):
            found += [
                GateOrder(place=place, gate=gate, least=least, setting=setting)
                for gate, (least, setting) in rank(methods).least_by_sweep().items()
                if gate != REFERENCE
            ]
    return tuple(found)


def _common(cells: Sequence[CellScores], policies: Sequence[str]) -> Mapping[str, Sequence[TrialScore]]:
    """Policy -> its trials, of those that every policy has."""
    of_policy = {
        name: trials_of((c for c in cells if c.label == name), "safety_gated", without=()).scores for name in policies
    }
    keys = set.intersection(*(set(scores) for scores in of_policy.values()))
    return {name: [scores[key] for key in sorted(keys, key=str)] for name, scores in of_policy.items()}
