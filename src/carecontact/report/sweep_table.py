"""The table of all cells of a sweep, and whether the order of the policies holds in all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from carecontact.policies.registry import Role
from carecontact.report.sweep_levels import (
    Factors,
    GateOrder,
    Ladder,
    Trials,
    factors,
    gate_orders,
    ladder,
    of_role,
    trials_of,
)
from carecontact.report.tables import POOLED, SummaryRow, counts_of, headlines, sorted_scores
from carecontact.report.words import enough
from carecontact.runs.pooling import check_one_run, check_ranked, judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import kendall_tau
from carecontact.stats.persons import GENERATOR_SEED, RESAMPLES

LOW, HIGH = 5.0, 95.0
"""Percentiles between which a band lies."""


@dataclass(frozen=True, kw_only=True)
class Band:
    """The spread of one metric over the trials for which it is defined."""

    n: int
    low: float
    median: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Spread:
    """One policy in one task, over all combinations of the axes and all seeds."""

    policy: str
    task: str
    passed: int
    n: int
    bands: dict[str, Band | None]
    """Id of a headline metric -> its band; None where it is defined for no trial."""


@dataclass(frozen=True, kw_only=True)
class Flips:
    """Draws in which two policies stand the other way round than over all draws of one task."""

    a: str
    b: str
    task: str
    by: dict[str, tuple[int, int]]
    """``passed`` or the id of a headline metric -> such draws, of how many in which both have a number. Left out
    where the two are equal over all."""


@dataclass(frozen=True, kw_only=True)
class Bands:
    spreads: tuple[Spread, ...]
    flips: tuple[Flips, ...]


def bands(cells: Sequence[CellScores], outcome: str, *, ranked: Sequence[str]) -> Bands | None:
    """Return the spread of each metric over draws, and where ranked policies change places; None where no policy has
    two trials of a task. A *draw* is one combination of the axes' values and one seed."""
    policies = list(dict.fromkeys(cell.label for cell in cells))
    found = {name: trials_of((c for c in cells if c.label == name), outcome, without=()) for name in policies}
    tasks = sorted({task for one in found.values() for _, task, _ in one.scores})
    alone = {
        (name, task): Trials(scores={key: s for key, s in one.scores.items() if key[1] == task}, outcome=outcome)
        for name, one in found.items()
        for task in tasks
    }
    spreads = [
        Spread(
            policy=name,
            task=task,
            passed=sum(map(one.passed, one.scores)),
            n=len(one.scores),
            bands={metric.id: _band(metric.pooled(one.scores.values())) for metric in headlines()},
        )
        for (name, task), one in alone.items()
        if one.scores
    ]
    if max((one.n for one in spreads), default=0) < 2:
        return None
    flips = [_flips(a, b, task, alone[a, task], alone[b, task]) for a, b in combinations(ranked, 2) for task in tasks]
    return Bands(spreads=tuple(spreads), flips=tuple(one for one in flips if one.by))


def _band(values: Sequence[float | None]) -> Band | None:
    valid = [value for value in values if value is not None]
    if not valid:
        return None
    low, median, high = map(float, np.percentile(valid, [LOW, 50.0, HIGH]))
    return Band(n=len(valid), low=low, median=median, high=high)


def _flips(a: str, b: str, task: str, of_a: Trials, of_b: Trials) -> Flips:
    keys = sorted(of_a.scores.keys() & of_b.scores.keys(), key=str)
    passed = [(float(of_a.passed(key)), float(of_b.passed(key))) for key in keys]
    by = {"passed": _reversed(passed, float(np.mean([x - y for x, y in passed])))} if passed else {}
    for metric in headlines():
        values = (metric.pooled([trials.scores[key] for key in keys]) for trials in (of_a, of_b))
        both = [(x, y) for x, y in zip(*values, strict=True) if x is not None and y is not None]
        if both:
            x, y = np.median(both, axis=0)
            by[metric.id] = _reversed(both, float(x - y))
    return Flips(a=a, b=b, task=task, by={name: found for name, found in by.items() if found is not None})


def _reversed(pairs: Sequence[tuple[float, float]], overall: float) -> tuple[int, int] | None:
    if overall == 0:
        return None
    return sum((x - y) * overall < 0 for x, y in pairs), len(pairs)


Table = dict[tuple[str, int], dict[str, bool]]
"""Task and seed -> policy -> whether it passed; only those that every policy ran."""
Values = tuple[tuple[str, str], ...]
"""One combination of the axes: axis and value of each."""


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
    ``pooling.SEEDS_FOR_INTERVAL`` seeds."""
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


def stability(
    groups: Mapping[Values, Mapping[str, Sequence[TrialScore]]], policies: Sequence[str], *, outcome: str
) -> Stability | None:
    """Return how stable the order of the policies is; None where no combination has a trial of every policy.

    Args:
        groups: combination -> policy -> its trials.
        policies: at least two.
        outcome: field of a score that says whether a trial passed.
    """
    every = {values: _passes(scores, policies, outcome) for values, scores in groups.items()}
    passed_in = {values: table for values, table in every.items() if table}
    if not passed_in:
        return None
    tables = list(passed_in.values())
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


def _passes(scores: Mapping[str, Sequence[TrialScore]], policies: Sequence[str], outcome: str) -> Table:
    found = {
        name: {(s.task_id, s.seed): bool(getattr(s, outcome)) for s in judged(scores.get(name, ()))}
        for name in policies
    }
    common = sorted(set.intersection(*(set(of_policy) for of_policy in found.values())))
    return {key: {name: found[name][key] for name in policies} for key in common}


def _total(tables: Sequence[Table], policies: Sequence[str]) -> dict[str, int]:
    return {name: sum(row[name] for table in tables for row in table.values()) for name in policies}


def _tau(total: Mapping[str, int], here: Mapping[str, int], policies: Sequence[str]) -> float | None:
    return kendall_tau([total[name] for name in policies], [here[name] for name in policies]).tau


def _signs(passed: Mapping[str, int], policies: Sequence[str] | Mapping[str, int]) -> list[int]:
    """Return for every pair 1 where the first passes more often, and -1 where the second does."""
    return [(passed[a] > passed[b]) - (passed[a] < passed[b]) for a, b in combinations(policies, 2)]


def _order(a: str, b: str, tables: Sequence[Table], counts: Sequence[Mapping[str, int]], n: int) -> Order:
    by_seed: Counter[int] = Counter()
    for table in tables:
        for (_, seed), row in table.items():
            by_seed[seed] += row[a] - row[b]
    signs = [(here[a] > here[b]) - (here[a] < here[b]) for here in counts]
    share: list[float | None] = [None] * 3
    if enough(len(by_seed)):
        # Seeds are drawn with replacement, all trials of one seed together.
        generator, seeds = np.random.default_rng(GENERATOR_SEED), len(by_seed)
        times = generator.multinomial(seeds, np.full(seeds, 1.0 / seeds), size=RESAMPLES)
        drawn = np.sign(times @ np.array([by_seed[seed] for seed in sorted(by_seed)]))
        share = [float(np.mean(drawn == sign)) for sign in (1, 0, -1)]
    return Order(
        a=a,
        b=b,
        difference=sum(by_seed.values()) / n,
        higher=signs.count(1),
        equal=signs.count(0),
        lower=signs.count(-1),
        resampled_higher=share[0],
        resampled_equal=share[1],
        resampled_lower=share[2],
    )


def _marginals(passed_in: Mapping[Values, Table], policies: Sequence[str], total: Mapping[str, int]) -> list[Marginal]:
    rows: list[Marginal] = []
    for axis, _ in next(iter(passed_in)):
        values = dict.fromkeys(dict(combination)[axis] for combination in passed_in)
        # One value has no others to be set beside.
        for value in values if len(values) > 1 else ():
            tables = [table for combination, table in passed_in.items() if dict(combination)[axis] == value]
            passed = _total(tables, policies)
            n = sum(map(len, tables))
            rows.append(Marginal(axis=axis, value=value, passed=passed, n=n, tau=_tau(total, passed, policies)))
    return rows


RATES = {"safety_gated": "safety-gated", "region_correct": "region-correct", "success": "success"}
"""Field of a plan -> what tables call it."""
PASSED = RATES | {"success": "successful"}
"""Field of a plan -> the trials that have it."""


@dataclass(frozen=True, kw_only=True)
class CellScores:
    label: str
    """The policy's name."""
    role: Role = "method"
    values: dict[str, str]
    """Axis -> value."""
    folder: str
    """Folder of the cell's run, relative to the sweep's folder."""
    planned: int
    """Trials."""
    scores: Sequence[TrialScore]
    """Scores of the trials that have run; empty for a cell that has not."""
    versions: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """Package -> the versions with which the trials were recorded."""

    @property
    def unknown(self) -> int:
        """Planned trials without a verdict."""
        return self.planned - sum(score.is_judged for score in self.scores)


@dataclass(frozen=True, kw_only=True)
class CellRow:
    cell: CellScores
    counts: SummaryRow | None
    """Counts over all judged trials of the cell; None where nothing has run."""
    crashed: int
    harness_errors: int


@dataclass(frozen=True, kw_only=True)
class SweepTable:
    title: str
    axes: tuple[str, ...]
    policies: tuple[str, ...]
    rank_by: str
    rows: tuple[CellRow, ...]
    stability: Stability | None
    bands: Bands | None
    """None for a plan that compares levels or factors, whose trials are no draws of one population."""
    ladder: Ladder | None
    factors: Factors | None
    gate_orders: tuple[GateOrder, ...]
    """Orders of the ranked policies under other values of the gates."""

    @property
    def named(self) -> dict[str, str]:
        """Policy -> its name, with its role where it is no method: ``hover (blind)``."""
        roles = {row.cell.label: row.cell.role for row in self.rows}
        return {name: name if role == "method" else f"{name} ({role})" for name, role in roles.items()}

    @property
    def unfinished(self) -> int:
        """Cells that lack the verdict on a trial."""
        return sum(row.cell.unknown > 0 for row in self.rows)


def sweep_table(title: str, cells: Sequence[CellScores], *, rank_by: str) -> SweepTable:
    """``cells``: in the order of the plan. Raises ConfigError for a cell whose trials must not be pooled."""
    policies = tuple(dict.fromkeys(cell.label for cell in cells))
    groups: dict[Values, dict[str, Sequence[TrialScore]]] = {}
    for cell in cells:
        groups.setdefault(tuple(cell.values.items()), {})[cell.label] = cell.scores
    ranked = ranked_policies(cells)
    compared = ladder(cells, OUTCOMES[rank_by]), factors(cells, OUTCOMES[rank_by])
    return SweepTable(
        title=title,
        axes=tuple(cells[0].values) if cells else (),
        policies=policies,
        rank_by=rank_by,
        rows=tuple(map(_row, cells)),
        stability=stability(groups, ranked, outcome=OUTCOMES[rank_by]) if len(ranked) > 1 else None,
        bands=bands(cells, OUTCOMES[rank_by], ranked=ranked) if compared == (None, None) else None,
        ladder=compared[0],
        factors=compared[1],
        gate_orders=gate_orders(cells, ranked),
    )


def ranked_policies(cells: Sequence[CellScores]) -> list[str]:
    """Return the methods or, where the plan has not two of them, all policies: those that have a verdict on every
    planned trial."""
    methods = of_role(cells, "method")
    unfinished = {cell.label for cell in cells if cell.unknown}
    wanted = methods if len(methods) > 1 else list(dict.fromkeys(cell.label for cell in cells))
    return [name for name in wanted if name not in unfinished]


OUTCOMES = {"safety_gated": "safety_gated", "region_correct": "region_correct", "success": "c3_success"}
"""Field of a plan -> field of a score."""


def _row(cell: CellScores) -> CellRow:
    check_one_run(cell.scores)
    check_ranked(cell.scores, f"{cell.label}: ")
    counts = counts_of(POOLED, "All trials", sorted_scores(cell.scores), unknown=cell.unknown)
    return CellRow(
        cell=cell,
        counts=counts if cell.scores else None,
        crashed=sum(score.is_crash for score in cell.scores),
        harness_errors=sum(not score.is_judged for score in cell.scores),
    )
