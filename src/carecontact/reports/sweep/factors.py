"""One factor at a time: what each variation of the hardest level does alone, and what is left without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from carecontact.reports.sweep.persons import trials_of
from carecontact.runs.sweep.factors import ALL, AXIS, NONE, alone, without
from carecontact.stats import PersonDifference, PersonRate, holm

if TYPE_CHECKING:
    from carecontact.reports.sweep.table import CellScores


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
    """Return what each factor costs and gives back; None where the plan switches no factors, or where nothing has run.

    Args:
        outcome: field of a score that says whether a trial passed.
    """
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
    names = [value.removeprefix(alone("")) for _, value in found if value.startswith(alone(""))]
    rows = [
        (factor, name, found[name, alone(factor)], found[name, NONE], found[name, without(factor)], found[name, ALL])
        for name in policies
        for factor in dict.fromkeys(names)
    ]
    pairs = [(plus.minus(none), minus.minus(every)) for *_, plus, none, minus, every in rows]
    adjusted = iter(holm([one.test.pvalue for pair in pairs for one in pair]).adjusted)
    return Factors(
        low={name: found[name, NONE].rate for name in policies},
        high={name: found[name, ALL].rate for name in policies},
        effects=tuple(
            Effect(
                factor=factor,
                policy=name,
                alone=plus.rate,
                costs=costs,
                costs_p_holm=next(adjusted),
                without=minus.rate,
                gives_back=gives_back,
                gives_back_p_holm=next(adjusted),
            )
            for (factor, name, plus, _, minus, _), (costs, gives_back) in zip(rows, pairs, strict=True)
        ),
    )
