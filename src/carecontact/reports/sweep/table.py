"""The table of a sweep: one row for each cell, and the statistics over all cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from carecontact.policies.registry import Role
from carecontact.reports.sweep.bands import Bands, bands
from carecontact.reports.sweep.factors import Factors, factors
from carecontact.reports.sweep.gate_orders import GateOrder, gate_orders
from carecontact.reports.sweep.ladder import Ladder, ladder
from carecontact.reports.sweep.persons import of_role
from carecontact.reports.sweep.stability import Group, Stability, stability
from carecontact.reports.table import POOLED, SummaryRow, counts_of, sorted_scores
from carecontact.runs.pooling import check_one_run
from carecontact.scoring.result import TrialScore

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
    """How stable the order of the ranked policies is. None with only one such policy, or where no place has a trial of
    every one."""
    bands: Bands | None
    """Spread of each metric; None for a plan that compares levels or factors, whose trials are no draws of one
    population."""
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
    places: dict[tuple[tuple[str, str], ...], dict[str, Sequence[TrialScore]]] = {}
    for cell in cells:
        places.setdefault(tuple(cell.values.items()), {})[cell.label] = cell.scores
    ranked = ranked_policies(cells)
    groups = [Group(values=dict(values), scores=of_policy) for values, of_policy in places.items()]
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
    counts = counts_of(POOLED, "All trials", sorted_scores(cell.scores), unknown=cell.unknown)
    return CellRow(
        cell=cell,
        counts=counts if cell.scores else None,
        crashed=sum(score.is_crash for score in cell.scores),
        harness_errors=sum(not score.is_judged for score in cell.scores),
    )
