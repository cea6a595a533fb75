"""State-machine against voxposer again, with another stiffness of the arm or another tissue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tools.study.plan import PAIR, PRIMARY, SWEEPS, conditions
from tools.study.sorted_runs import Found

from carecontact.contract.protocol import Protocol
from carecontact.reports.compare.comparison import Comparison, compare_runs
from carecontact.reports.compare.outcomes import RATES, Outcome, score_outcomes
from carecontact.reports.table import summary_rows
from carecontact.stats import RankingSweep, ranking_sweep


@dataclass(frozen=True, kw_only=True)
class Level:
    value: str
    is_protocol: bool
    comparison: Comparison | None
    """state-machine against voxposer; None where a run is missing"""
    gated: dict[str, dict[str, tuple[int, int]]]
    """Method -> task -> safety-gated trials, of how many; of the runs that are there"""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    field: str
    levels: tuple[Level, ...]
    ranking: dict[str, RankingSweep]
    """Outcome -> Kendall's tau of each level's order against that under the protocol; empty without the latter"""

    @property
    def was_run(self) -> bool:
        """Under any condition but the protocol's own."""
        return any(level.gated and not level.is_protocol for level in self.levels)


def sweep_of(field: str, found: Found, protocol: Protocol) -> Sweep:
    foreign = {value: condition for condition in conditions(protocol) for name, value in condition if name == field}
    levels: list[Level] = []
    for value in SWEEPS[field]:
        here = {
            name: found[name, condition][1]
            for name, condition in ((name, foreign.get(value, ())) for name in PAIR)
            if (name, condition) in found
        }
        levels.append(
            Level(
                value=value,
                is_protocol=value not in foreign,
                comparison=compare_runs(*here.values()) if len(here) == len(PAIR) else None,
                gated={
                    name: {row.task_id: (row.safety_gated, row.n) for row in summary_rows(run.scores)[:-1]}
                    for name, run in here.items()
                },
            )
        )
    present = [level for level in levels if level.comparison is not None]
    reference = next((level.value for level in present if level.is_protocol), None)
    ranking: dict[str, RankingSweep] = {}
    if reference is not None:
        for outcome in (o for o in (*RATES, *score_outcomes()) if o.id in PRIMARY):
            values = {level.value: standing(level, outcome) for level in present}
            ranking[outcome.id] = ranking_sweep(values, reference=reference)
    return Sweep(field=field, levels=tuple(levels), ranking=ranking)


def standing(level: Level, outcome: Outcome) -> dict[str, float | None]:
    """Method -> its rate or median over the trials that both have, negative where lower is better."""
    assert level.comparison is not None
    line = next(line for line in level.comparison.overall if line.outcome.id == outcome.id)
    sign = 1 if outcome.better == "higher" else -1
    values: Sequence[float | None] = (line.a.estimate, line.b.estimate)
    return {name: None if v is None else sign * v for name, v in zip(PAIR, values, strict=True)}
