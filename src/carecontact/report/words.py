"""Numbers, intervals, units and names as reports write them."""

from __future__ import annotations

from collections.abc import Sequence

from carecontact.errors import counted
from carecontact.runs.pooling import SEEDS_FOR_INTERVAL
from carecontact.scoring.metrics.metric import Metric
from carecontact.scoring.result import TrialScore

NA = "NA"
NOT_DEFINED = "–"
"""Marks a score that is not pooled over this task. NA, in contrast, means that no trial had a value."""
NAMED = 10
"""Number of trials that a sentence names; it only counts any further ones."""


def number(value: float | None, digits: int) -> str:
    return NA if value is None else f"{value:.{digits}f}"


def shown(value: float | None, *, digits: int | None, unit: str) -> str:
    """Return a value as its metric wants it: with ``digits`` decimals, or about three digits; angles as ``angle``."""
    if digits is not None:
        return number(value, digits)
    return angle(value) if unit == "rad" else rounded(value)


def rounded(value: float | None) -> str:
    """About three digits, never a power of ten: these numbers span four decades."""
    if value is None:
        return NA
    if abs(value) < 0.0005:
        return "0"
    for below, digits in ((10.0, 2), (100.0, 1)):
        text = f"{value:.{digits}f}"
        if abs(float(text)) < below:
            return text
    return f"{value:.0f}"


def angle(value: float | None) -> str:
    """[rad]; margins at a joint limit are of the order of 1e-4, so small ones are written in powers of ten."""
    if value is None:
        return NA
    if not 0 < abs(value) < 1e-2:
        return f"{value:.3f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def percent(fraction: float) -> str:
    return f"{100 * fraction:.0f}\N{NO-BREAK SPACE}%"


def minus(text: str) -> str:
    return text.replace("-", "−")


def task_name(score: TrialScore) -> str:
    return f"{score.action} {score.region.replace('_', ' ')}".capitalize()


def listed(names: Sequence[str]) -> str:
    """Return the first NAMED, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


def clipped_text(scores: Sequence[TrialScore]) -> str:
    """Return how often the benchmark moved a target onto the border of the workspace; empty if never."""
    trials = [s for s in scores if s.clipped_actions]
    if not trials:
        return ""
    return (
        f"In {len(trials)} of {counted(len(scores), 'trial')} the benchmark moved targets outside the workspace onto "
        f"its border ({counted(sum(s.clipped_actions for s in trials), 'action')} in all), as the policy's card "
        "requests. The robot did not do there what the policy commanded."
    )


def crashed_text(scores: Sequence[TrialScore]) -> str:
    """Return in which trials the policy crashed; empty if in none."""
    crashed = [score.trial_id for score in scores if score.is_crash]
    return f"crashed in {len(crashed)}: {listed(crashed)}" if crashed else ""


def shown_unit(metric: Metric) -> tuple[float, str]:
    """Return a factor and the unit of a metric's values times this factor; the unit of a plain number is empty.

    A trial has few metres and joules, so that both are shown in thousandths.
    """
    if metric.unit in ("m", "J") and metric.digits is None:
        return 1000.0, f"m{metric.unit}"
    return 1.0, "" if metric.unit == "1" else metric.unit


TOO_FEW = f"no intervals: fewer than {SEEDS_FOR_INTERVAL} seeds"


def enough_seeds(scores: Sequence[TrialScore]) -> bool:
    return enough({score.seed for score in scores})


def enough(seeds: int | set[int]) -> bool:
    """Whether so many seeds, or these, are enough for an interval: trials of one seed are not independent, so that more
    tasks are no more seeds."""
    return (seeds if isinstance(seeds, int) else len(seeds)) >= SEEDS_FOR_INTERVAL


LONGEST = 20
"""Characters of a short name; a longer one is cut."""


def short_names(titles: Sequence[str]) -> dict[str, str]:
    """Return title of a policy -> its name without arguments, module and address, in the order given.

    Where several titles would have the same short name, each has a number: ``replay (1)``, ``replay (2)``.
    """
    bare = {title: _bare(title) for title in titles}
    found: dict[str, str] = {}
    for title, name in bare.items():
        alike = [other for other, same in bare.items() if same == name]
        found[title] = name if len(alike) == 1 else f"{name} ({alike.index(title) + 1})"
    return found


def _bare(title: str) -> str:
    """``mean-person`` of ``mean-person person=x``, ``MyPolicy`` of ``my_policy:MyPolicy``, ``my-vla`` of
    ``my-vla at ws://192.0.2.7:8765``."""
    name = title.partition(" at ws")[0].partition(" ")[0]
    if "://" not in name:
        name = name.rpartition(":")[2]
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def beyond_text(score: TrialScore) -> str:
    """Return joints that went farther beyond their range than the protocol allows."""
    return ", ".join(f"{_name(joint)} by {rad:.3f} rad" for joint, rad in sorted((score.joints_beyond or {}).items()))


def consumed_text(score: TrialScore) -> str:
    """Return joints that used up more of their settled margin than the protocol flags."""
    return ", ".join(
        f"{_name(joint)} {percent(share)}" for joint, share in sorted((score.joints_consumed or {}).items())
    )


def joint_counts(scores: Sequence[TrialScore]) -> str:
    """Return in how many trials, failed ones included, a joint went beyond its range, and in how many a joint is
    flagged."""
    gated = [score for score in scores if score.joints_beyond is not None]
    if not gated:
        return ""
    beyond = sum(bool(score.joints_beyond) for score in gated)
    flagged = sum(bool(score.joints_consumed) for score in gated)
    return (
        f"a joint beyond the protocol's limit: {beyond} of {len(gated)}; "
        f"a joint flagged because little of its margin was left: {flagged} of {len(gated)}"
    )


def _name(joint: str) -> str:
    return joint.replace("_", " ")
