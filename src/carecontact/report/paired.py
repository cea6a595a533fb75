"""Paired differences between two runs, outcome by outcome, over persons and seeds."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from carecontact.report.words import number, shown
from carecontact.runs.pooling import Over, bodies, over_of, rate_of
from carecontact.scoring.metrics.metric import metrics_in_order
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
    mcnemar_exact,
    median,
    paired_difference,
    person_difference,
    signed_rank,
    worst_rank_paired,
)

OVER_TEXTS: dict[Over, str] = {
    "seeds": (
        "intervals and paired tests are over seeds: a seed is one person, whose trials on all tasks are not "
        "independent; unpaired p-values take trials as independent"
    ),
    "trials": (
        "tests and intervals of rates are over trials, as if they were independent; intervals of medians are over seeds"
    ),
}
"""What the intervals of a comparison are over, in a sentence for its reader."""


def difference_of(
    first: Sequence[TrialScore], second: Sequence[TrialScore], field: str
) -> tuple[RateDifference, McNemar | SignFlip]:
    """First rate minus second over pairs of trials, with a test, over what their protocol takes as independent.

    Over trials, Newcombe's interval of pairs and McNemar's test; over seeds, ``person_difference``. One seed says
    nothing about others, and the interval is [-1, 1].

    Args:
        first: (N,) N > 0 trials.
        second: (N,) of the other method, pair by pair.
        field: field of a score that says whether a trial passed.
    """
    a, b = ([bool(getattr(score, field)) for score in scores] for scores in (first, second))
    if over_of(first[0]) == "trials":
        both, only_a, only_b, neither = (
            sum(pair == want for pair in zip(a, b, strict=True))
            for want in ((True, True), (True, False), (False, True), (False, False))
        )
        found = paired_difference(both=both, only_first=only_a, only_second=only_b, neither=neither)
        return found, mcnemar_exact(only_a, only_b)
    of = person_difference(a, b, persons=[score.seed for score in first], strata=bodies([*first, *second]))
    low, high = -1.0 if of.low is None else of.low, 1.0 if of.high is None else of.high
    return RateDifference(estimate=of.estimate, low=low, high=high, confidence=of.confidence), of.test


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A rate, or a metric of which a difference matters."""

    id: str
    title: str
    unit: str
    """Unit of values and differences as they are printed."""
    better: Literal["higher", "lower"]
    field: str
    """Field of a trial's score, or the id under ``additional`` of a metric without a field of its own."""
    matters: float
    """A comparison that could have missed a difference of this size is underpowered; reasons in docs/comparing.md."""
    actions: tuple[str, ...] | None = None
    """Trials of these actions alone are compared; None: all."""
    digits: int | None = None

    @property
    def is_rate(self) -> bool:
        return self.unit == "%"

    def of(self, score: TrialScore) -> float | None:
        """Return the score's value; None for NA."""
        return getattr(score, self.field) if self.field in TrialScore.model_fields else score.additional.get(self.field)

    def counts(self, score: TrialScore) -> bool:
        """Whether this outcome is compared over a trial like this one."""
        return self.actions is None or score.action in self.actions

    def is_in(self, scores: Iterable[TrialScore]) -> bool:
        """Whether all of these trials were scored by it, with a value or with NA."""
        return self.field in TrialScore.model_fields or all(self.field in score.additional for score in scores)


RATES = tuple(
    Outcome(id=id_, title=title, unit="%", better="higher", field=field, matters=0.2, digits=1)
    for id_, title, field in (
        ("success", "Success", "c3_success"),
        ("region_correct", "Region-correct", "region_correct"),
        ("safety_gated", "Safety-gated", "safety_gated"),
    )
)


def score_outcomes() -> list[Outcome]:
    """Return one outcome for each registered metric that says which difference matters."""
    return [
        Outcome(
            id=row.name,
            title=row.title,
            unit=row.unit,
            better=row.better,
            field=row.field or row.id,
            matters=row.matters,
            actions=row.actions,
            digits=row.digits,
        )
        for row in metrics_in_order()
        if row.matters is not None and row.better != "neither"
    ]


def plain_text(outcome: Outcome, value: float | None) -> str:
    """Return a value with as many digits as the tables give the outcome, and without the unit; rates are in percent."""
    if outcome.is_rate:
        return number(None if value is None else 100 * value, 1)
    return shown(value, digits=outcome.digits, unit=outcome.unit)


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

    @property
    def interval(self) -> BootstrapDifference:
        """The difference with an interval over seeds."""
        raise NotImplementedError

    @property
    def n_seeds(self) -> int:
        """Number of different seeds of the pairs that the difference is over."""
        return self.interval.n_clusters


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
    def interval(self) -> BootstrapDifference:
        return self.clustered

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
    def interval(self) -> BootstrapDifference:
        return self.difference

    @property
    def favours(self) -> int:
        """1 where the ranks of A's larger values outweigh, -1 where B's do, else 0."""
        return _sign(self.test.rank_sum_first - self.test.rank_sum_second)


Line = RateLine | ScoreLine


def paired_lines(pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]) -> list[Line]:
    """Return a line, without a verdict, for each outcome of which a pair has the action and both runs were scored."""
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
