"""Which trials of a run count and may be counted together, and the scores of a run as one object."""

from __future__ import annotations

import re
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

from carecontact.errors import ConfigError, counted
from carecontact.protocol.protocol import TRAINING_SHA256
from carecontact.recording.schema import RANKED
from carecontact.scoring.result import DRAWN, TrialScore
from carecontact.stats import Proportion, person_rate, wilson_interval

UNSALTED = "none"
"""Stands for the salt's hash in a run on published seeds, whose persons are others than those of a salted one."""

TRIAL = re.compile(r".+-s\d{3,}")


def judged(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """Return the trials that say something about the policy: all but those in which the harness failed."""
    return [s for s in scores if s.is_judged]


def unjudged(
    scores: Iterable[TrialScore], *, skipped: Mapping[str, str], missing: Iterable[str], elsewhere: Iterable[str] = ()
) -> dict[str, str]:
    """Trial id -> why a planned trial has no verdict, in the order of the ids. A run with one is incomplete.

    Args:
        skipped: file name -> why it was not scored; a file that is not named after a trial is none.
        missing: trials that were planned and have no score.
        elsewhere: trials of the other parts of the run.
    """
    scores = list(scores)
    why = dict.fromkeys(elsewhere, "in another part of the run") | dict.fromkeys(missing, "no recording")
    unscored = {Path(name).stem: f"its recording cannot be scored: {reason}" for name, reason in skipped.items()}
    why |= {name: reason for name, reason in unscored.items() if TRIAL.fullmatch(name)}
    for score in scores:
        why.pop(score.trial_id, None)
    why |= {error["trial_id"]: f"the harness failed: {error['message']}" for error in harness_errors(scores)}
    return dict(sorted(why.items()))


def task_of(trial_id: str) -> str:
    """``T1-s003`` -> ``T1``."""
    return trial_id.rpartition("-s")[0]


def share(k: int, n: int, unknown: int = 0) -> str:
    """Return a count, of ``n`` trials with a verdict: ``9 of 18``, or ``9 to 12 of 18`` where three have none."""
    return f"{k} to {k + unknown} of {n + unknown}" if unknown else f"{k} of {n}"


def incomplete(n: int, unknown: Iterable[str]) -> str:
    """Return ``incomplete, 15 of 18 planned trials have a verdict``; empty for a complete run."""
    planned = n + len(list(unknown))
    have = counted(planned, "planned trial has", "planned trials have")
    return f"incomplete, {n} of {have} a verdict" if planned > n else ""


def decides_force(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """Return the trials that count for force limits: all but those in which the policy crashed before any contact."""
    return [s for s in scores if not s.crashed_untouched]


def harness_errors(scores: Iterable[TrialScore]) -> list[dict[str, str]]:
    failed = [score for score in scores if not score.is_judged]
    return [{"trial_id": s.trial_id, "message": s.failure_message or "no reason recorded"} for s in failed]


def with_names(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """Return the scores, with the name of the policy also where it crashed before it showed its card. Otherwise, a
    server that answers one trial with silence would be taken for another policy, and the run could not be counted. The
    name is the one that the same address showed in the other trials; where it showed several or none, nothing is
    added."""
    names: dict[tuple[object, ...], set[str]] = {}
    asked = [(score, (score.policy, *sorted(score.policy_arguments.items()))) for score in scores]
    for score, address in asked:
        if score.policy_name is not None:
            names.setdefault(address, set()).add(score.policy_name)
    found: list[TrialScore] = []
    for score, address in asked:
        shown = names.get(address, set[str]())
        nameless = score.policy_name is None and score.is_crash and len(shown) == 1
        found.append(score.model_copy(update={"policy_name": min(shown)}) if nameless else score)
    return found


def check_one_run(scores: Sequence[TrialScore]) -> None:
    """Raises ConfigError for scores of several protocols, policies or worlds, whose rates must not be pooled."""
    protocols = {f"{score.protocol_title} ({score.protocol_sha256[:12]})" for score in scores}
    for what, found in (("protocols", protocols), ("policies", {score.policy_title for score in scores})):
        if len(found) > 1:
            raise ConfigError(f"trials of {len(found)} {what} must not be pooled: {', '.join(sorted(found))}")
    if not all(map(in_process, scores)):
        check_ranked(scores)
    if (differing := world_difference(judged(scores))) is not None:
        what, first, other = differing
        raise ConfigError(
            f"{first.trial_id}.h5 and {other.trial_id}.h5 were simulated in different worlds and must not be pooled: "
            f"{what} {world_part(first, what)} and {world_part(other, what)}"
        )


def in_process(score: TrialScore) -> bool:
    """Whether no worker of a run ran the trial, or it ran on a person to train on, whatever its recording claims."""
    return score.provenance.get("origin", "isolated") not in RANKED or score.world.get("salt") == TRAINING_SHA256


def not_ranked(trial: str, origin: str) -> ConfigError:
    if origin != "in-process":
        return ConfigError(
            f"{trial} is a demonstration, of a person on whom policies are trained. It can be scored, exported and "
            "looked at, but not compared, ranked or merged; run the policy on the protocol's seeds"
        )
    return ConfigError(
        f"{trial} was recorded in-process: an Episode in somebody's own program made it, in which the policy could "
        "reach the simulation. It can be scored and looked at, but not compared, ranked or merged; run the policy with "
        "`carecontact run`"
    )


def check_ranked(scores: Iterable[TrialScore], place: str = "") -> None:
    """Raises ConfigError for an in-process trial and for a demonstration. ``place``: begins the message."""
    if (found := next((score for score in scores if in_process(score)), None)) is not None:
        raise not_ranked(f"{place}{found.trial_id}.h5", found.provenance.get("origin", "isolated"))


def world_part(score: TrialScore, what: str) -> str:
    """Return a part of a score's world as messages name it: of a hash, the start."""
    value = score.world.get(what, UNSALTED)
    return value[:12] if len(value) == 64 else value


def world_difference(
    scores: Sequence[TrialScore], *, but: Collection[str] = ()
) -> tuple[str, TrialScore, TrialScore] | None:
    """Return the first part of the world, ``but`` for some, in which two scores differ, and the two; of drawn bodies,
    at one seed."""
    first: dict[tuple[object, ...], TrialScore] = {}
    for score in scores:
        for what, value in {"salt": UNSALTED, **score.world}.items():
            if what in but:
                continue
            place = (what, score.seed) if what.startswith(DRAWN) else (what,)
            other = first.setdefault(place, score)
            if other.world.get(what, UNSALTED) != value:
                return what, other, score
    return None


PROVENANCE = {"arithmetic": "arithmetic", "renderer": "renderer", "kernel": "binary of the tissue"}
"""Part of a score's provenance -> what it is, as messages name it. The compiled model follows from these."""
EFFECT = (
    "another arithmetic changed 2 of 378 measured verdicts, another arithmetic and renderer 2 of 378 "
    "(docs/results/README.md)"
)


def machines(scores: Iterable[TrialScore], what: str) -> list[str]:
    """Return the different values of a part of the provenance of trials, as messages name them."""
    found = {score.provenance.get(what, "not recorded") for score in scores if score.provenance or score.is_judged}
    return sorted(value[:12] if what == "kernel" else value for value in found)


def rejected_text(scores: Iterable[TrialScore]) -> str:
    """Return a sentence for trials on a tissue whose calibration was rejected; empty for others."""
    found = sorted({text for score in scores if (text := score.world.get("rejected_tissue"))})
    if not found:
        return ""
    rejected = f"The calibration of this tissue was rejected: {'; '.join(found)}."
    return f"{rejected} Forces and indentations here are not those of the tissue that was measured."


def mixed(scores: Sequence[TrialScore]) -> str:
    """Return a sentence for a run whose trials do not all name one machine; empty for one machine."""
    found = {title: values for name, title in PROVENANCE.items() if len(values := machines(scores, name)) > 1}
    differ = "; ".join(f"{title}: {' and '.join(values)}" for title, values in found.items())
    return f"The trials of this run may come from different machines ({differ}); {EFFECT}." if differ else ""


@dataclass(frozen=True, kw_only=True)
class RunScores:
    scores: list[TrialScore]
    """The scores in the order of the file names."""
    skipped: dict[str, str] = field(default_factory=dict[str, str])
    """File name -> why it was not scored."""
    versions: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Package -> every version that the scored recordings name, and those of the packages whose metrics scored them;
    more than one means a mixed run."""
    missing: tuple[str, ...] = ()
    """Trials that were planned and have no score; where no plan is known, none."""
    elsewhere: tuple[str, ...] = ()
    """Trials of the other parts of the run of which this is a part (``run --shard``)."""

    @cached_property
    def unjudged(self) -> dict[str, str]:
        """Planned trial -> why it has no verdict; empty for a complete run."""
        return unjudged(self.scores, skipped=self.skipped, missing=self.missing, elsewhere=self.elsewhere)

    @property
    def incomplete(self) -> str:
        """``incomplete, 15 of 18 planned trials have a verdict``; empty for a complete run."""
        return incomplete(len(judged(self.scores)), self.unjudged)

    @property
    def completing(self) -> str:
        """What makes an incomplete run complete, as a part of a sentence."""
        parts = all(trial in self.elsewhere for trial in self.unjudged)
        return "join its parts with `carecontact merge`" if parts else "give its `carecontact run` command again"


Over = Literal["trials", "seeds"]
SEEDS_FOR_INTERVAL = 6
"""Least number of seeds for an interval. With fewer pairs, not even a difference in every one of them is significant:
the exact two-sided sign test gives 2 / 2^5 = 0.0625 for five, and 0.03125 for six."""


def over_of(score: TrialScore) -> Over:
    """Return ``seeds`` where the protocol has levels, which share their persons, or draws bodies or places by seed.

    Elsewhere, the seed changes only the angle of the arm, and trials are taken as independent, as the paper does.
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
