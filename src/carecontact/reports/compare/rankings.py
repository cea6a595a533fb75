"""Whether the ranking of several methods stays the same with other values of the gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from carecontact.runs.aggregate import gamma_sweep, gate_sweep
from carecontact.scoring.result import TrialScore
from carecontact.stats import RankingSweep, ranking_sweep

GAMMAS = tuple(round(0.2 + 0.05 * i, 2) for i in range(17))
REFERENCE = "safety_gated"
"""Level of a sweep at which every gate has the protocol's own value."""
STEPS = {REFERENCE: "safety_gated", "region_correct": "region_correct", "success": "c3_success"}
"""Level -> field of a score."""


@dataclass(frozen=True, kw_only=True)
class Ranking:
    order: tuple[tuple[str, ...], ...]
    """Methods by their share of safety-gated trials under the protocol's own gates, best first; equal ones together."""
    shares: dict[str, dict[str, float | None]]
    """Level -> method -> share of its trials. ``gamma 0.35`` and ``push_force_n 5`` are safety-gated shares there."""
    sweep: RankingSweep
    """Every level against the reference."""

    def least_by_sweep(self) -> dict[str, tuple[float | None, str]]:
        """Sweep -> its smallest tau, and the level where that is; None where no level orders the methods."""
        out: dict[str, tuple[float | None, str]] = {}
        for level, found in self.sweep.tau.items():
            if level == self.sweep.reference:
                continue
            name = level.partition(" ")[0]
            least, _ = out.setdefault(name, (None, ""))
            if found.tau is not None and (least is None or found.tau < least):
                out[name] = (found.tau, level)
        return out


def rank(methods: Mapping[str, Sequence[TrialScore]]) -> Ranking:
    """Order methods by safety-gated trials, and again at every other step of the funnel, discount and swept gate.

    Args:
        methods: name -> its judged trials; the same tasks and seeds for all, at least two methods.
    """
    shares: dict[str, dict[str, float | None]] = {
        step: {name: _share(sum(bool(getattr(s, field)) for s in scores), scores) for name, scores in methods.items()}
        for step, field in STEPS.items()
    }
    gates = {name: gate_sweep(scores) for name, scores in methods.items()}
    for name, scores in methods.items():
        for row in gamma_sweep(scores, GAMMAS):
            shares.setdefault(f"gamma {row['gamma']:g}", {})[name] = _share(row["safety_gated"], scores)
        for gate, rows in gates[name].items():
            for row in rows:
                shares.setdefault(f"{gate} {row['value']:g}", {})[name] = _share(row["safety_gated"], scores)
    shares = {level: found for level, found in shares.items() if found.keys() == methods.keys()}
    best = shares[REFERENCE]
    values = sorted({v for v in best.values() if v is not None}, reverse=True)
    return Ranking(
        order=tuple(tuple(name for name in methods if best[name] == value) for value in values),
        shares=shares,
        sweep=ranking_sweep(shares, reference=REFERENCE),
    )


def _share(k: int, scores: Sequence[TrialScore]) -> float | None:
    return k / len(scores) if scores else None
