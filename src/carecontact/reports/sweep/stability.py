"""Whether the ranking of the policies is the same in every cell of a sweep, and would be the same with other seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from carecontact.reports.intervals import enough
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import kendall_tau
from carecontact.stats.bootstrap import GENERATOR_SEED, RESAMPLES

Key = tuple[str, int]
"""Task and seed."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """One combination of the axes' values."""

    values: dict[str, str]
    scores: Mapping[str, Sequence[TrialScore]]
    """Policy -> its trials."""


@dataclass(frozen=True, kw_only=True)
class Marginal:
    """All combinations in which an axis, one that has several values, has one of them."""

    axis: str
    value: str
    passed: dict[str, int]
    n: int
    """Trials of each policy."""
    tau: float | None
    """Kendall's tau-b of the order here with the overall one; None where one of them orders nothing."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """The order of two policies, of which a passes at least as often as b over all trials."""

    a: str
    b: str
    difference: float
    """Difference of their shares of passed trials over all trials."""
    higher: int
    """Combinations in which a passes more often than b."""
    equal: int
    lower: int
    resampled_higher: float | None
    """Share of the resamples of the seeds in which a passes more often than b over all; None with fewer than
    ``intervals.SEEDS_FOR_INTERVAL`` seeds."""
    resampled_equal: float | None
    resampled_lower: float | None


@dataclass(frozen=True, kw_only=True)
class Stability:
    n: int
    """Trials of each policy: those of tasks and seeds that every policy ran in a combination."""
    groups: int
    """Combinations with such trials."""
    seeds: int
    passed: dict[str, int]
    """Policy -> trials; the highest first."""
    taus: tuple[float, ...]
    """Kendall's tau-b of each combination's order with the overall one, where both order anything."""
    unordered: int
    """Combinations in which every policy passes equally often."""
    same: int
    """Combinations in which every pair is ordered, or equal, as over all."""
    orders: tuple[Order, ...]
    marginals: tuple[Marginal, ...]


def stability(groups: Sequence[Group], policies: Sequence[str], *, outcome: str) -> Stability | None:
    """Return how stable the order of the policies is; None where no combination has a trial of every policy.

    Args:
        policies: at least two.
        outcome: field of a score that says whether a trial passed.
    """
    passed_in = [(group, _passes(group, policies, outcome)) for group in groups]
    passed_in = [(group, table) for group, table in passed_in if table]
    if not passed_in:
        return None
    tables = [table for _, table in passed_in]
    total = _total(tables, policies)
    ordered = dict(sorted(total.items(), key=lambda pair: -pair[1]))
    counts = [_total([table], policies) for table in tables]
    n = sum(map(len, tables))
    taus = [_tau(total, here, policies) for here in counts]
    return Stability(
        n=n,
        groups=len(tables),
        seeds=len({seed for table in tables for _, seed in table}),
        passed=ordered,
        taus=tuple(tau for tau in taus if tau is not None),
        unordered=sum(len(set(here.values())) == 1 for here in counts),
        same=sum(_signs(here, ordered) == _signs(total, ordered) for here in counts),
        orders=tuple(_order(a, b, tables, counts, n) for a, b in combinations(ordered, 2)),
        marginals=tuple(_marginals(passed_in, policies, total)),
    )


def _passes(group: Group, policies: Sequence[str], outcome: str) -> dict[Key, dict[str, bool]]:
    """Task and seed -> policy -> whether it passed; those alone that every policy ran."""
    found = {
        name: {(s.task_id, s.seed): bool(getattr(s, outcome)) for s in judged(group.scores.get(name, ()))}
        for name in policies
    }
    common = sorted(set.intersection(*(set(of_policy) for of_policy in found.values())))
    return {key: {name: found[name][key] for name in policies} for key in common}


def _total(tables: Sequence[dict[Key, dict[str, bool]]], policies: Sequence[str]) -> dict[str, int]:
    return {name: sum(row[name] for table in tables for row in table.values()) for name in policies}


def _tau(total: Mapping[str, int], here: Mapping[str, int], policies: Sequence[str]) -> float | None:
    return kendall_tau([total[name] for name in policies], [here[name] for name in policies]).tau


def _signs(passed: Mapping[str, int], policies: Sequence[str] | Mapping[str, int]) -> list[int]:
    """Return for every pair 1 where the first passes more often, and -1 where the second does."""
    return [(passed[a] > passed[b]) - (passed[a] < passed[b]) for a, b in combinations(policies, 2)]


def _order(
    a: str, b: str, tables: Sequence[dict[Key, dict[str, bool]]], counts: Sequence[Mapping[str, int]], n: int
) -> Order:
    by_seed: dict[int, int] = {}
    for table in tables:
        for (_, seed), row in table.items():
            by_seed[seed] = by_seed.get(seed, 0) + row[a] - row[b]
    signs = [(here[a] > here[b]) - (here[a] < here[b]) for here in counts]
    drawn = _resampled(by_seed)
    return Order(
        a=a,
        b=b,
        difference=sum(by_seed.values()) / n,
        higher=signs.count(1),
        equal=signs.count(0),
        lower=signs.count(-1),
        resampled_higher=None if drawn is None else float(np.mean(drawn > 0)),
        resampled_equal=None if drawn is None else float(np.mean(drawn == 0)),
        resampled_lower=None if drawn is None else float(np.mean(drawn < 0)),
    )


def _resampled(by_seed: Mapping[int, int]) -> np.ndarray[tuple[int], np.dtype[np.int64]] | None:
    """(RESAMPLES,) sums over seeds that are drawn with replacement, all trials of one seed together."""
    seeds = len(by_seed)
    if not enough(seeds):
        return None
    generator = np.random.default_rng(GENERATOR_SEED)
    times = generator.multinomial(seeds, np.full(seeds, 1.0 / seeds), size=RESAMPLES)
    return times @ np.array([by_seed[seed] for seed in sorted(by_seed)])


def _marginals(
    passed_in: Sequence[tuple[Group, dict[Key, dict[str, bool]]]], policies: Sequence[str], total: Mapping[str, int]
) -> list[Marginal]:
    rows: list[Marginal] = []
    for axis in passed_in[0][0].values:
        values = dict.fromkeys(group.values[axis] for group, _ in passed_in)
        # One value has no others to be set beside.
        for value in values if len(values) > 1 else ():
            tables = [table for group, table in passed_in if group.values[axis] == value]
            passed = _total(tables, policies)
            n = sum(map(len, tables))
            rows.append(Marginal(axis=axis, value=value, passed=passed, n=n, tau=_tau(total, passed, policies)))
    return rows
