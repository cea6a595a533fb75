"""What the statistics of a protocol take as independent: its trials, or its seeds with all tasks of each."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Literal

from carecontact.runs.pooling import judged
from carecontact.scoring.result import DRAWN, TrialScore
from carecontact.stats import (
    McNemar,
    Proportion,
    RateDifference,
    SignFlip,
    mcnemar_exact,
    paired_difference,
    person_difference,
    person_rate,
    wilson_interval,
)

Over = Literal["trials", "seeds"]
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


def over_of(score: TrialScore) -> Over:
    """Return ``seeds`` where the protocol of a trial has levels, which share their persons, or draws bodies or places
    by seed.

    Elsewhere, the seed changes the angle of the arm alone, and trials are taken as independent, as the paper does.
    """
    has_level = " " in score.protocol_id
    return "seeds" if has_level or any(name.startswith(DRAWN) for name in score.world) else "trials"


def bodies(scores: Iterable[TrialScore]) -> dict[int, Hashable]:
    """Seed -> the bodies that the protocol or a plan chose for it; seeds with the same ones are a stratum. A body that
    the seed draws is as random as everything else about its person, and makes no stratum."""
    found: dict[int, set[str]] = {}
    for score in scores:
        found.setdefault(score.seed, set()).add(score.world.get("body", ""))
    return {seed: tuple(sorted(names)) for seed, names in found.items()}


def rate_of(scores: Sequence[TrialScore], field: str) -> Proportion:
    """Share of the judged trials whose ``field`` is true, over what their protocol takes as independent: Wilson's
    interval of trials, or ``person_rate`` of seeds."""
    counted = judged(scores)
    passed = [bool(getattr(score, field)) for score in counted]
    if not counted or over_of(counted[0]) == "trials":
        return wilson_interval(sum(passed), len(passed))
    found = person_rate(passed, persons=[score.seed for score in counted], strata=bodies(counted))
    return Proportion(
        k=found.k, n=found.n, confidence=found.confidence, estimate=found.estimate, low=found.low, high=found.high
    )


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
