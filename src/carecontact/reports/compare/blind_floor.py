"""The best baseline for each task, a blind one wherever there is any: the rate that can be reached without vision."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carecontact.policies.registry import Role, role_of
from carecontact.reports.over_seeds import rate_of
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion

ALL = "all"
"""Stands for all tasks together in place of the name of one."""


@dataclass(frozen=True, kw_only=True)
class FloorRate:
    """Safety-gated trials of the baseline that passes most."""

    policy: str
    blind: bool
    """Whether it is registered as a blind baseline."""
    rate: Proportion


def role_in(scores: Sequence[TrialScore]) -> Role:
    """Return the role of a run's policy; a recording that says ``privileged`` is believed whatever the policy is
    called."""
    if any(score.privileged for score in scores):
        return "privileged"
    return role_of(scores[0].policy) if scores else "method"


def blind_floor(kept: Iterable[Sequence[TrialScore]], like: TrialScore) -> dict[str, FloorRate]:
    """Return ALL and each task -> its best blind rate; empty where no blind baseline ran this protocol.

    Each place takes its own best, so tasks may name different policies. With several levels of one protocol, a level
    has its own floor.

    Args:
        kept: scores of runs, for example those stored beside published results; runs of methods, of probes, of
            privileged policies, and of other rules than those of ``like`` are passed over.
        like: any trial under the rules whose floor is wanted.
    """
    same = [[score for score in judged(scores) if _same_rules(score, like)] for scores in kept]
    return floor_of(scores for scores in same if scores and role_in(scores) == "blind")


def floor_of(baselines: Iterable[Sequence[TrialScore]]) -> dict[str, FloorRate]:
    """ALL and each task -> the best rate there; the first of equal ones.

    Args:
        baselines: judged trials of each, one at least.
    """
    best: dict[str, FloorRate] = {}
    for scores in baselines:
        for place in (ALL, *sorted({score.task_id for score in scores})):
            rate = rate_of([score for score in scores if place in (ALL, score.task_id)], "safety_gated")
            if place not in best or rate.k / rate.n > best[place].rate.k / best[place].rate.n:
                blind = role_in(scores) == "blind"
                best[place] = FloorRate(policy=scores[0].policy_title, blind=blind, rate=rate)
    return best


def _same_rules(score: TrialScore, like: TrialScore) -> bool:
    return (score.protocol_sha256, score.overrides) == (like.protocol_sha256, like.overrides)
