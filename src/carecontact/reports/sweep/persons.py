"""The trials of some cells as statistics over persons need them."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from carecontact.policies.registry import Role
from carecontact.reports.over_seeds import bodies
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import PersonDifference, PersonRate, WorstShare, person_difference, person_rate, worst_share

if TYPE_CHECKING:
    from carecontact.reports.sweep.table import CellScores

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
