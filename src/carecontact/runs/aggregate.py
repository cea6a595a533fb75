"""Counts over the trials of a run beyond rates and medians: screens, quadrants, sweeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from carecontact.runs.pooling import decides_force
from carecontact.scoring.metrics.metric import described
from carecontact.scoring.result import TrialScore
from carecontact.stats import median, wilson_interval

GAMMAS = tuple(round(i / 100, 2) for i in range(20, 101))
"""Discounts at which the safety gate is swept."""
LEVELS = ("success", "region_correct", "safety_gated")


def rate(k: int, n: int, *, unknown: int = 0) -> dict[str, Any]:
    """Return a count in percent with its Wilson interval; without trials, there is no percentage.

    Further trials of which nobody knows the verdict leave no percentage, but ``pc_between``, from all of them failed to
    all of them passed, and an interval that covers those of both.
    """
    least, most = wilson_interval(k, n + unknown), wilson_interval(k + unknown, n + unknown)
    between = [0.0, 100.0] if least.estimate is None or most.estimate is None else [
        100 * least.estimate, 100 * most.estimate,
    ]  # fmt: skip
    percent = None if unknown or least.estimate is None else 100 * least.estimate
    return {"n": k, "pc": percent, "pc_between": between, "pc_ci95": [100 * least.low, 100 * most.high]}


def within(score: TrialScore, gamma: float) -> bool:
    """No touched segment above ``gamma`` F_pain; at the protocol's own discount the same as an empty ``over_limit``."""
    return not any(peak / (gamma * score.f_pain_n[s]) > 1.0 for s, peak in score.peak_force_n.items())


def exceedances(scores: Sequence[TrialScore], *, unknown: int = 0) -> dict[str, Any]:
    """Return trials, failed ones too, with a touched segment above the safety gate or above the pain limit, and how
    many of them were successes all the same. The percentages are of the trials that ``decides_force`` leaves.

    ``unknown``: planned trials without a verdict."""
    scores = decides_force(scores)
    over = {
        "gate": [s for s in scores if s.over_limit],
        "pain": [s for s in scores if not within(s, 1.0)],
    }
    return {
        name: rate(len(found), len(scores), unknown=unknown) | {"n_success": sum(s.c3_success for s in found)}
        for name, found in over.items()
    }


def quadrants(scores: Iterable[TrialScore]) -> dict[str, int]:
    """Safe (no force above its safety gate, no joint beyond the gate for joints) or not, success (C3) or not. Without
    any touch: a safe failure. A trial in which the policy crashed is in a class of its own: it is never safe, and
    ``exceedances`` counts its force."""
    scores = list(scores)
    count = Counter((not s.over_limit and not s.joints_beyond, s.c3_success) for s in scores if not s.is_crash)
    fields = {
        f"{'safe' if safe else 'unsafe'}_{'success' if success else 'failure'}": count[safe, success]
        for safe in (True, False)
        for success in (True, False)
    }
    return {**fields, "crashed": sum(s.is_crash for s in scores)}


def valid_ratio(scores: Sequence[TrialScore], *, unknown: int = 0) -> dict[str, Any]:
    """Share of trials that have a trajectory to score. Coverage of the data, not success.

    ``unknown``: planned trials without a verdict."""
    return rate(sum(s.c4_motion_activity is not None for s in scores), len(scores), unknown=unknown)


def gamma_sweep(
    scores: Sequence[TrialScore], gammas: Sequence[float] = GAMMAS, *, unknown: int = 0
) -> list[dict[str, Any]]:
    """Safety-gated trials at each discount: region-correct, not truncated, no joint too far beyond its range, and
    ``within`` it. With ``unknown``, planned trials without a verdict, there is no percentage."""
    correct = [s for s in scores if s.region_correct and s.ended != "safety_truncation" and not s.joints_beyond]
    rows: list[dict[str, Any]] = []
    for gamma in gammas:
        k = sum(within(s, gamma) for s in correct)
        rows.append(
            {"gamma": gamma, "safety_gated": k, "pc": 100 * k / len(scores) if scores and not unknown else None}
        )
    return rows


def gate_sweep(scores: Sequence[TrialScore]) -> dict[str, list[dict[str, Any]]]:
    """Gate -> one row per value, in rising order: trials that reach each step of the funnel."""
    values: dict[str, set[str]] = {}
    for score in scores:
        for name, row in score.gate_sweep.items():
            values.setdefault(name, set()).update(row)
    return {
        name: [
            {"value": float(value)}
            | {
                step: sum(s.gate_sweep.get(name, {}).get(value, 0) >= depth for s in scores)
                for depth, step in enumerate(LEVELS, start=1)
            }
            for value in sorted(values[name], key=float)
        ]
        for name in sorted(values)
    }


def additional_medians(scores: Sequence[TrialScore]) -> dict[str, dict[str, Any]]:
    """Metric id -> median, for every metric without a field of its own that any of the scores has."""
    rows = [described(id_) for id_ in sorted({id_ for s in scores for id_ in s.additional})]
    return {row.id: asdict(median(row.pooled(scores))) for row in rows if row.median}
