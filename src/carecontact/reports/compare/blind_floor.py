"""The best blind baseline for each task: the rate that can be reached without vision, as a column beside every rate."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carecontact.policies.registry import Role, role_of
from carecontact.runs.pooling import judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, wilson_interval

ALL = "all"
"""In place of a task: all of them, pooled."""


@dataclass(frozen=True, kw_only=True)
class BlindRate:
    """Safety-gated trials of the blind baseline that passes most."""

    policy: str
    rate: Proportion


def role_in(scores: Sequence[TrialScore]) -> Role:
    """The role of a run's policy; a recording that says ``privileged`` is believed whatever the policy is called."""
    if any(score.privileged for score in scores):
        return "privileged"
    return role_of(scores[0].policy) if scores else "method"


def blind_floor(kept: Iterable[Sequence[TrialScore]], like: TrialScore) -> dict[str, BlindRate]:
    """Return ALL and each task -> its best blind rate; empty where no blind baseline ran this protocol.

    Each place takes its own best, so tasks may name different policies. With several levels of one protocol, a level
    has its own floor.

    Args:
        kept: scores of runs, for example those stored beside published results; runs of methods, of probes, of
            privileged policies, and of other rules than those of ``like`` are passed over.
        like: any trial under the rules whose floor is wanted.
    """
    best: dict[str, BlindRate] = {}
    for scores in kept:
        counted = [score for score in judged(scores) if _same_rules(score, like)]
        if not counted or role_in(counted) != "blind":
            continue
        for place in (ALL, *sorted({score.task_id for score in counted})):
            here = [score for score in counted if place in (ALL, score.task_id)]
            raise_floor(best, place, here[0].policy_title, sum(score.safety_gated for score in here), len(here))
    return best


def raise_floor(best: dict[str, BlindRate], place: str, policy: str, k: int, n: int) -> None:
    """Enter a policy with ``k`` of ``n`` trials at a place of ``best`` if no other has a higher rate there."""
    if n and (place not in best or k / n > best[place].rate.k / best[place].rate.n):
        best[place] = BlindRate(policy=policy, rate=wilson_interval(k, n))


def _same_rules(score: TrialScore, like: TrialScore) -> bool:
    return (score.protocol_sha256, score.overrides) == (like.protocol_sha256, like.overrides)
