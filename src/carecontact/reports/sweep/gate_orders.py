"""Whether the order of the methods survives other gates and discounts, level by level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from carecontact.reports.compare.rankings import REFERENCE, rank
from carecontact.reports.sweep.ladder import level_of, levels_of
from carecontact.reports.sweep.persons import trials_of
from carecontact.scoring.result import TrialScore

if TYPE_CHECKING:
    from carecontact.reports.sweep.table import CellScores

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
