"""One line of a comparison: an outcome over the paired trials of two runs."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from carecontact.reports.compare.outcomes import RATES, Outcome, score_outcomes
from carecontact.reports.over_seeds import Over, bodies, difference_of, over_of, rate_of
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
    SignFlip,
    WorstRank,
    clustered_bootstrap,
    fisher_exact,
    mann_whitney,
    median,
    signed_rank,
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
    over: Over
    """What intervals of rates, and paired tests, take as independent: the trials, or the seeds."""
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
    """The same difference with an interval that keeps a seed's tasks together, and its standard error."""
    test: McNemar | SignFlip
    """The paired test: over trials McNemar's; over seeds, one that flips the signs of whole seeds."""
    unpaired_a: Proportion
    """The rate over every trial of the tasks that both runs have, paired or not."""
    unpaired_b: Proportion
    unpaired: FisherExact

    @property
    def n_seeds(self) -> int:
        return self.clustered.n_clusters

    @property
    def favours(self) -> int:
        """1 where A is higher in more pairs, -1 where B is, else 0."""
        return _sign(self.a.k - self.b.k)


@dataclass(frozen=True, kw_only=True)
class ScoreLine(_Concluded):
    """Differences are A minus B, in the outcome's unit."""

    a: Median
    """The median over the paired trials in which the score exists."""
    b: Median
    n_only_a: int
    """Pairs in which A alone has the score."""
    n_only_b: int
    n_neither: int
    difference: BootstrapDifference
    """Median of the differences, over pairs in which both have the score."""
    test: SignedRank
    worst_rank: WorstRank
    """The test over all pairs, where having no score is worse than any score."""
    unpaired_a: Median
    unpaired_b: Median
    unpaired: MannWhitney | None
    """None where a run has no value."""
    worst_rank_p_holm: float | None = None

    @property
    def n_seeds(self) -> int:
        """Number of different seeds of the pairs in which both trials have the score."""
        return self.difference.n_clusters

    @property
    def favours(self) -> int:
        """1 where the ranks of A's larger values outweigh, -1 where B's do, else 0."""
        return _sign(self.test.rank_sum_first - self.test.rank_sum_second)


Line = RateLine | ScoreLine


def paired_lines(pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]) -> list[Line]:
    """Return a line for each outcome over these pairs, without verdicts.

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
    """Return the lines of success, region-correct and safety-gated alone, without verdicts."""
    return [_rate_line(outcome, pairs, every_a, every_b) for outcome in RATES]


def _rate_line(
    outcome: Outcome, pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]
) -> RateLine:
    of_a, of_b = [x for x, _ in pairs], [y for _, y in pairs]
    difference, test = difference_of(of_a, of_b, outcome.field)
    unpaired_a, unpaired_b = (rate_of(every, outcome.field) for every in (every_a, every_b))
    return RateLine(
        outcome=outcome,
        n_pairs=len(pairs),
        over=over_of(of_a[0]),
        a=rate_of(of_a, outcome.field),
        b=rate_of(of_b, outcome.field),
        difference=difference,
        clustered=clustered_bootstrap(
            [bool(outcome.of(x)) for x in of_a],
            [bool(outcome.of(y)) for y in of_b],
            clusters=[x.seed for x in of_a],
            strata=_strata(pairs),
            statistic="difference_of_means",
        ),
        test=test,
        unpaired_a=unpaired_a,
        unpaired_b=unpaired_b,
        unpaired=fisher_exact(unpaired_a.k, unpaired_a.n, unpaired_b.k, unpaired_b.n),
    )


def _score_line(
    outcome: Outcome, pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]
) -> ScoreLine:
    def values(scores: Iterable[TrialScore]) -> list[float | None]:
        return [outcome.of(score) for score in scores]

    a, b = values(x for x, _ in pairs), values(y for _, y in pairs)
    all_a, all_b = values(every_a), values(every_b)
    valid_a, valid_b = ([v for v in found if v is not None] for found in (all_a, all_b))
    seeds, over = [x.seed for x, _ in pairs], over_of(pairs[0][0])
    together = seeds if over == "seeds" else None
    worst = worst_rank_paired(a, b, better=outcome.better, clusters=together)
    return ScoreLine(
        outcome=outcome,
        n_pairs=len(pairs),
        over=over,
        a=median(a),
        b=median(b),
        n_only_a=worst.n_only_first,
        n_only_b=worst.n_only_second,
        n_neither=sum(x is None and y is None for x, y in zip(a, b, strict=True)),
        difference=clustered_bootstrap(a, b, clusters=seeds, strata=_strata(pairs)),
        test=signed_rank(a, b, clusters=together),
        worst_rank=worst,
        unpaired_a=median(all_a),
        unpaired_b=median(all_b),
        unpaired=mann_whitney(valid_a, valid_b) if valid_a and valid_b else None,
    )


def _strata(pairs: Sequence[Pair]) -> dict[int, Hashable] | None:
    """Seed -> stratum, where the statistics are over seeds."""
    return bodies(score for pair in pairs for score in pair) if over_of(pairs[0][0]) == "seeds" else None


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)
