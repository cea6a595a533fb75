"""One line of a comparison: an outcome over the paired trials of two runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from carecontact.reports.compare.outcomes import RATES, Outcome, score_outcomes
from carecontact.scoring.result import TrialScore
from carecontact.stats import (
    BootstrapDifference,
    DetectableDifference,
    FisherExact,
    MannWhitney,
    McNemar,
    Median,
    Proportion,
    RateDifference,
    SignedRank,
    WorstRank,
    clustered_bootstrap,
    fisher_exact,
    mann_whitney,
    mcnemar_exact,
    median,
    paired_difference,
    signed_rank,
    wilson_interval,
    worst_rank_paired,
)

Word = Literal["A higher", "B higher", "no difference detected", "underpowered"]
Pair = tuple[TrialScore, TrialScore]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    word: Word
    text: str
    """The word and its reason."""


@dataclass(frozen=True, kw_only=True)
class _Concluded:
    """What both kinds of line have; the last four come from ``verdicts.conclude``."""

    outcome: Outcome
    n_pairs: int
    p_holm: float | None = None
    detectable: DetectableDifference | None = None
    verdict: Verdict | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RateLine(_Concluded):
    """Differences are A minus B, as fractions."""

    a: Proportion
    b: Proportion
    difference: RateDifference
    clustered: BootstrapDifference
    """The same difference with an interval that keeps a seed's tasks together."""
    test: McNemar
    unpaired_a: Proportion
    """Over every trial of the tasks that both runs have, paired or not."""
    unpaired_b: Proportion
    unpaired: FisherExact

    @property
    def n_seeds(self) -> int:
        return self.clustered.n_clusters

    @property
    def favours(self) -> int:
        """1 where A is higher in more pairs, -1 where B is, else 0."""
        return _sign(self.test.only_first - self.test.only_second)


@dataclass(frozen=True, kw_only=True)
class ScoreLine(_Concluded):
    """Differences are A minus B, in the outcome's unit."""

    a: Median
    """Over the paired trials in which the score exists."""
    b: Median
    n_only_a: int
    """Pairs in which A alone has the score."""
    n_only_b: int
    n_neither: int
    difference: BootstrapDifference
    """Median of the differences, over pairs in which both have the score."""
    test: SignedRank
    worst_rank: WorstRank
    """Over all pairs; no score is the worst score."""
    unpaired_a: Median
    unpaired_b: Median
    unpaired: MannWhitney | None
    """None where a run has no value."""
    worst_rank_p_holm: float | None = None

    @property
    def n_seeds(self) -> int:
        """Of the pairs in which both have the score."""
        return self.difference.n_clusters

    @property
    def favours(self) -> int:
        """1 where the ranks of A's larger values outweigh, -1 where B's do, else 0."""
        return _sign(self.test.rank_sum_first - self.test.rank_sum_second)


Line = RateLine | ScoreLine


def paired_lines(pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]) -> list[Line]:
    """A line for each outcome over these pairs, without verdicts.

    An outcome has none where no pair is of its actions or where a run was scored without it.
    """
    lines: list[Line] = [*rate_lines(pairs, every_a, every_b)]
    for outcome in score_outcomes():
        kept = [pair for pair in pairs if outcome.counts(pair[0])]
        of_a, of_b = ([score for score in every if outcome.counts(score)] for every in (every_a, every_b))
        if kept and outcome.is_in(of_a) and outcome.is_in(of_b):
            lines.append(_score_line(outcome, kept, of_a, of_b))
    return lines


def rate_lines(pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]) -> list[RateLine]:
    """The lines of success, region-correct and safety-gated alone, without verdicts."""
    return [_rate_line(outcome, pairs, every_a, every_b) for outcome in RATES]


def _rate_line(
    outcome: Outcome, pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]
) -> RateLine:
    a, b = [bool(outcome.of(x)) for x, _ in pairs], [bool(outcome.of(y)) for _, y in pairs]
    only_a = sum(x and not y for x, y in zip(a, b, strict=True))
    only_b = sum(y and not x for x, y in zip(a, b, strict=True))
    both = sum(a) - only_a
    k_a, k_b = (sum(bool(outcome.of(s)) for s in every) for every in (every_a, every_b))
    return RateLine(
        outcome=outcome,
        n_pairs=len(pairs),
        a=wilson_interval(sum(a), len(a)),
        b=wilson_interval(sum(b), len(b)),
        difference=paired_difference(
            both=both, only_first=only_a, only_second=only_b, neither=len(a) - both - only_a - only_b
        ),
        clustered=clustered_bootstrap(a, b, clusters=[x.seed for x, _ in pairs], statistic="difference_of_means"),
        test=mcnemar_exact(only_a, only_b),
        unpaired_a=wilson_interval(k_a, len(every_a)),
        unpaired_b=wilson_interval(k_b, len(every_b)),
        unpaired=fisher_exact(k_a, len(every_a), k_b, len(every_b)),
    )


def _score_line(
    outcome: Outcome, pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]
) -> ScoreLine:
    def values(scores: Iterable[TrialScore]) -> list[float | None]:
        return [outcome.of(score) for score in scores]

    a, b = values(x for x, _ in pairs), values(y for _, y in pairs)
    all_a, all_b = values(every_a), values(every_b)
    valid_a, valid_b = ([v for v in found if v is not None] for found in (all_a, all_b))
    worst = worst_rank_paired(a, b, better=outcome.better)
    return ScoreLine(
        outcome=outcome,
        n_pairs=len(pairs),
        a=median(a),
        b=median(b),
        n_only_a=worst.n_only_first,
        n_only_b=worst.n_only_second,
        n_neither=sum(x is None and y is None for x, y in zip(a, b, strict=True)),
        difference=clustered_bootstrap(a, b, clusters=[x.seed for x, _ in pairs]),
        test=signed_rank(a, b),
        worst_rank=worst,
        unpaired_a=median(all_a),
        unpaired_b=median(all_b),
        unpaired=mann_whitney(valid_a, valid_b) if valid_a and valid_b else None,
    )


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)
