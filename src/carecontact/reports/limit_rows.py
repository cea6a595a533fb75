"""Trials above a force limit: the safety gate, the protocol's pain limits, and every other pack of limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from carecontact.runs.pooling import decides_force, judged, share
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, wilson_interval

Ratio = Callable[[TrialScore, str], float]


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    name: str
    note: str
    """Source of the limit, and whether it was checked."""
    above: Proportion
    """Trials, failed ones too, with a touched segment above the limit, of those that ``decides_force`` leaves."""
    unknown: int
    """Planned trials without a verdict."""
    n_success: int
    """How many of these trials succeeded all the same."""
    worst: float | None
    """Largest peak over its limit of any trial; None where nothing was touched."""
    worst_at: str
    """Trial and segment; empty where nothing was touched."""

    @property
    def count(self) -> str:
        """``2 of 15``, or ``2 to 5 of 18`` where three planned trials have no verdict."""
        return share(self.above.k, self.above.n, self.unknown)


def limit_rows(scores: Sequence[TrialScore], *, gamma: float | None, unknown: int = 0) -> list[LimitRow]:
    """Return one row for each set of limits over the trials that are ``judged``: the safety gate first, and packs that
    the protocol does not use last. Empty where no trial decides: the policy crashed in every one before any contact.

    Args:
        gamma: the protocol's discount, for the name of the gate; None where no recording could be read.
        unknown: planned trials without a verdict.
    """
    counted = decides_force(judged(scores))
    if not counted:
        return []
    own = {s.metric_versions.get("limits", "") for s in counted}
    share = "the protocol's share" if gamma is None else f"{gamma:g}"
    title = ", ".join(LIMIT_PACKS[p].title if p in LIMIT_PACKS else p for p in sorted(own) if p) or "pain limits"
    rows = [
        _row(f"Safety gate, {share} of the pain limit", "decides whether a trial is safety-gated", counted,
             _gate_ratio(gamma), lambda s: bool(s.over_limit), unknown),
        _row(title, "the protocol's pain limits, F_pain", counted, _pain_ratio, None, unknown),
    ]  # fmt: skip
    for name, pack in LIMIT_PACKS.items():
        if name not in own and pack.unit == "N":
            rows.append(
                _row(pack.title, pack.source, counted,
                     lambda s, segment, pack=pack: s.peak_force_n[segment] / pack.limit(segment), None, unknown)
            )  # fmt: skip
    return rows


def _row(
    name: str,
    note: str,
    scores: Sequence[TrialScore],
    ratio: Ratio | None,
    is_above: Callable[[TrialScore], bool] | None,
    unknown: int,
) -> LimitRow:
    ratios = [(ratio(s, segment), s, segment) for s in scores for segment in s.peak_force_n] if ratio else []
    worst = max(ratios, key=lambda row: row[0], default=None)
    if is_above is None:
        over = {s.trial_id for r, s, _ in ratios if r > 1.0}
        above = [s for s in scores if s.trial_id in over]
    else:
        above = [s for s in scores if is_above(s)]
    return LimitRow(
        name=name,
        note=note,
        above=wilson_interval(len(above), len(scores)),
        unknown=unknown,
        n_success=sum(s.c3_success for s in above),
        worst=None if worst is None else worst[0],
        worst_at="" if worst is None else f"{worst[1].trial_id}, {worst[2].replace('_', ' ')}",
    )


def _pain_ratio(score: TrialScore, segment: str) -> float:
    return score.peak_force_n[segment] / score.f_pain_n[segment]


def _gate_ratio(gamma: float | None) -> Ratio | None:
    return None if gamma is None else lambda score, segment: _pain_ratio(score, segment) / gamma
