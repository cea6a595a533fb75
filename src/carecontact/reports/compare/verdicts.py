"""The verdict on each line of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from carecontact.reports.compare.outcomes import plain_text
from carecontact.reports.compare.paired_lines import Line, RateLine, ScoreLine, Verdict
from carecontact.stats import (
    BootstrapDifference,
    DetectableDifference,
    McNemar,
    detectable_from_standard_error,
    holm,
    paired_detectable_difference,
)

ALPHA = 0.05
"""Level of significance of the whole family of tests."""
POWER = 0.8
FEW_SEEDS = 5
"""Below this many seeds the bootstrap's standard error says nothing."""


def conclude(lines: Sequence[Line]) -> list[Line]:
    """Return the lines with p-values adjusted over the family, what could have been detected, and a verdict for
    each."""
    adjusted = holm([line.test.pvalue for line in lines])
    worst = holm([line.worst_rank.pvalue if isinstance(line, ScoreLine) else None for line in lines])
    # What Holm requires of the smallest p-value: the only level that a line is sure to be tested at.
    alpha = ALPHA / max(adjusted.n, 1)
    concluded: list[Line] = []
    for line, p_holm, p_worst in zip(lines, adjusted.adjusted, worst.adjusted, strict=True):
        detectable = _detectable(line, alpha)
        verdict = _verdict(line, p_holm, detectable)
        if isinstance(line, ScoreLine):
            line = replace(line, worst_rank_p_holm=p_worst)
        line = replace(line, p_holm=p_holm, detectable=detectable, verdict=verdict)
        concluded.append(replace(line, notes=tuple(_notes(line))))
    return concluded


def _detectable(line: Line, alpha: float) -> DetectableDifference | None:
    """None where too few seeds make a guess of it, or the median stands still."""
    if isinstance(line.test, McNemar):
        discordance = (line.test.only_first + line.test.only_second) / line.n_pairs
        return paired_detectable_difference(n=line.n_pairs, discordance=discordance, power=POWER, alpha=alpha)
    # Even if all pairs, or seeds, differed the same way, the test of n of them would give 2 / 2^n.
    n = _interval(line).n_clusters if line.over == "seeds" else line.test.n
    if 2.0 ** (1 - n) > alpha:
        return DetectableDifference(difference=None, power=POWER, alpha=alpha)
    if isinstance(line, ScoreLine) and not line.test.n_unequal:
        return DetectableDifference(difference=0.0, power=POWER, alpha=alpha)
    if few_seeds(line):
        return None
    standard_error = _interval(line).standard_error
    if standard_error:
        return detectable_from_standard_error(standard_error, power=POWER, alpha=alpha)
    if isinstance(line, RateLine):
        # All seeds have the same difference: each says as much as a single pair, as its interval has it.
        discordance = abs(line.difference.estimate or 0.0)
        return paired_detectable_difference(n=n, discordance=discordance, power=POWER, alpha=alpha)
    # A median that no resample moves has no standard error either.
    return None


def _verdict(line: Line, p_holm: float | None, detectable: DetectableDifference | None) -> Verdict:
    outcome = line.outcome
    if p_holm is not None and p_holm <= ALPHA and line.favours:
        return Verdict(
            word="A higher" if line.favours > 0 else "B higher",
            text=f"{'A' if line.favours > 0 else 'B'} higher; {outcome.better} is better",
        )
    if p_holm is None:
        why = "no pair has this score in both runs"
    elif detectable is None:
        whence = (
            f"from {_seeds(line)}"
            if few_seeds(line)
            else "where so many pairs are equal that no resample moves the median"
        )
        why = f"{whence} nobody can tell what could have been detected"
    elif detectable.difference == 0:
        return Verdict(word="no difference detected", text="no difference detected; the pairs are equal")
    elif detectable.difference is None:
        why = "this comparison could not have detected any difference"
    else:
        unit = {"%": " points", "1": ""}.get(outcome.unit, f" {outcome.unit}")
        size = f"{plain_text(outcome, detectable.difference)}{unit}"
        if detectable.difference <= outcome.matters:
            return Verdict(
                word="no difference detected",
                text=(
                    f"no difference detected; a difference of {size} would have been detected with {POWER:.0%} power"
                ),
            )
        why = f"this comparison could not have detected a difference below {size}"
    return Verdict(word="underpowered", text=f"underpowered: {why}")


def _better(line: Line) -> int:
    """1 where the paired test favours A, -1 where it favours B, else 0."""
    return line.favours if line.outcome.better == "higher" else -line.favours


def _notes(line: Line) -> list[str]:
    """Return notes where another way of looking at the data says something else."""
    assert line.verdict is not None
    notes: list[str] = []
    decided = line.verdict.word in ("A higher", "B higher")
    if decided and few_seeds(line):
        notes.append(f"based on only {_seeds(line)}")
    interval = _interval(line)
    if decided and interval.low is not None and interval.high is not None and interval.low <= 0 <= interval.high:
        notes.append(
            "its interval does not exclude 0"
            if line.over == "seeds"
            else "an interval that keeps a seed's tasks together does not exclude 0"
        )
    if isinstance(line, ScoreLine) and line.worst_rank_p_holm is not None and line.worst_rank_p_holm <= ALPHA:
        side = {"first": 1, "second": -1, "neither": 0}[line.worst_rank.better]
        if side and not (decided and side == _better(line)):
            notes.append(f"with no score counted as the worst score {'A' if side > 0 else 'B'} is better")
    return notes


def few_seeds(line: Line) -> bool:
    """Whether there are so few seeds that neither an interval nor a standard error of theirs can be trusted."""
    return _interval(line).n_clusters < FEW_SEEDS


def _seeds(line: Line) -> str:
    n = _interval(line).n_clusters
    return f"{n} seed{'s' * (n != 1)}"


def _interval(line: Line) -> BootstrapDifference:
    return line.clustered if isinstance(line, RateLine) else line.difference
