"""Which trials of a run count, and which may be counted together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from carecontact.errors import ConfigError
from carecontact.scoring.result import DRAWN, TrialScore

UNSALTED = "none"
"""Stands for the salt's hash in a run on published seeds, whose persons are others than those of a salted one."""


def judged(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """Return the trials that say something about the policy: all but those in which the harness failed."""
    return [s for s in scores if s.is_judged]


def decides_force(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """Return the trials that count for exceedances of force limits: all but those in which the policy crashed before
    any contact."""
    return [s for s in scores if not s.crashed_untouched]


def harness_errors(scores: Iterable[TrialScore]) -> list[dict[str, str]]:
    """``trial_id`` and ``message`` of the trials in which the harness failed."""
    failed = [score for score in scores if not score.is_judged]
    return [{"trial_id": s.trial_id, "message": s.failure_message or "no reason recorded"} for s in failed]


def with_names(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """Return the scores, with the name of the policy also where it crashed before it showed its card.

    Otherwise, a server that answers one trial with silence would be taken for another policy, and the run could not be
    counted. The name is the one that the same address showed in the other trials; where it showed several or none,
    nothing is added.
    """
    scores = list(scores)
    names: dict[tuple[object, ...], set[str]] = {}
    for score in scores:
        if score.policy_name is not None:
            names.setdefault(_asked_for(score), set()).add(score.policy_name)
    return [
        score.model_copy(update={"policy_name": min(shown)})
        if score.policy_name is None and score.is_crash and len(shown := names.get(_asked_for(score), set[str]())) == 1
        else score
        for score in scores
    ]


def _asked_for(score: TrialScore) -> tuple[object, ...]:
    return (score.policy, *sorted(score.policy_arguments.items()))


def check_one_run(scores: Sequence[TrialScore]) -> None:
    """Raises ConfigError if the scores are of several protocols, policies or worlds: their rates must not be pooled."""
    protocols, policies = set[str](), set[str]()
    for score in scores:
        protocols.add(f"{score.protocol_title} ({score.protocol_sha256[:12]})")
        policies.add(score.policy_title)
    for what, found in (("protocols", protocols), ("policies", policies)):
        if len(found) > 1:
            raise ConfigError(f"trials of {len(found)} {what} must not be pooled: {', '.join(sorted(found))}")
    _check_one_world(judged(scores))


def _check_one_world(scores: Sequence[TrialScore]) -> None:
    found = world_difference(scores)
    if found is not None:
        what, first, other = found
        raise ConfigError(
            f"{first.trial_id}.h5 and {other.trial_id}.h5 were simulated in different worlds and must not be pooled: "
            f"{what} {world_part(first, what)} and {world_part(other, what)}"
        )


def world_part(score: TrialScore, what: str) -> str:
    """Return the start of a part of a score's world, as messages name it."""
    return score.world.get(what, UNSALTED)[:12]


def world_difference(scores: Sequence[TrialScore]) -> tuple[str, TrialScore, TrialScore] | None:
    """Return the first part of the world in which two scores differ, and the two; None in one world.

    The compiled model has the fine skin on the task's region, so that models are compared region by region, and those
    that a seed draws seed by seed.
    """
    first: dict[tuple[object, ...], TrialScore] = {}
    for score in scores:
        for what, value in {"salt": UNSALTED, **score.world}.items():
            place: tuple[object, ...] = (what, score.region) if what.endswith("model") else (what,)
            if what.startswith(DRAWN):
                place = (*place, score.seed)
            other = first.setdefault(place, score)
            if other.world.get(what, UNSALTED) != value:
                return what, other, score
    return None
