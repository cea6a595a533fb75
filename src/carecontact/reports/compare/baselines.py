"""What blind baselines pass: the floor under a method's rates.

A blind baseline is a policy that cannot do a task, because it does not look, touch or decide. Each of its successes is
a false positive of the gates. Beside them may stand a privileged policy, whose rate is the ceiling, and probes, which
change one thing about a method. None of them is ever ranked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from carecontact.errors import ConfigError
from carecontact.policies.registry import POLICIES, Role
from carecontact.reports.compare.blind_floor import ALL, BlindRate, raise_floor, role_in
from carecontact.reports.compare.comparable import check_comparable, trials_by_key
from carecontact.reports.compare.outcomes import RATES, Outcome
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, RateDifference, paired_difference, unpaired_difference, wilson_interval


@dataclass(frozen=True, kw_only=True)
class Passed:
    """What one policy passed.

    Rates by id: ``success``, ``region_correct``, ``safety_gated``. Those of a baseline are over the trials (task and
    seed) that the method has as well, or, where there is none, over all of its trials of the method's tasks.
    """

    policy: str
    n: int
    """Trials that the rates are over; harness errors are left out."""
    seeds: int
    """Different seeds of these trials."""
    rates: dict[str, Proportion]
    """Of a baseline: its false positives."""
    per_task: dict[str, dict[str, tuple[int, int]]]
    """Task -> rate -> count and number of trials."""
    role: Role = "method"
    """``blind`` for every named baseline that is not registered with another role."""
    n_pairs: int | None = None
    """Trials of the same task and seed in both; None for the method itself."""
    method_passed: int | None = None
    """Of these, how many the method passed safely (safety-gated); None for the method itself."""
    whole: Proportion | None = None
    """Safety-gated rate of a baseline over all of its trials of the method's tasks, where ``rates`` leave out some of
    them; None otherwise."""
    above_seeds: int | None = None
    """Different seeds that the differences rest on: those of the pairs or, without any, of the run that has fewer; None
    for the method itself."""
    above: dict[str, RateDifference] | None = None
    """Method minus baseline, as fractions: by pairs, or between independent trials where there is no pair."""


@dataclass(frozen=True, kw_only=True)
class Baselines:
    """Blind baselines beside a method."""

    method: Passed
    baselines: tuple[Passed, ...]
    floor: dict[str, BlindRate] = field(default_factory=dict[str, BlindRate])
    """``all`` and each task -> the safety-gated rate of the blind baseline that passes most there."""
    kept: tuple[str, ...] = ()
    """Those of ``baselines`` whose scores are kept with the package; methods that see may be among them."""
    completed: tuple[str, ...] = ()
    """Named ones of ``baselines`` whose run lacks trials that are kept with the package, and that have those here."""

    @property
    def tasks(self) -> tuple[str, ...]:
        return tuple(self.method.per_task)


def beside_baselines(method: RunScores, baselines: Sequence[RunScores], *, kept: Sequence[RunScores] = ()) -> Baselines:
    """Set blind baselines beside a method, over the trials that both have (``Passed``).

    A run that is named as a baseline counts as blind unless its policy is registered with another role; ``kept`` are
    scores that are kept with the package, of which a method stays a method.

    Differences are Newcombe's (method 10, of pairs or of independent trials), rates Wilson's. Raises ConfigError,
    naming what differs, for another protocol, overrides, definitions or world, a baseline that is the method itself or
    named twice, or one without a task in common.
    """
    seen = {method.scores[0].policy_title} if method.scores else set[str]()
    found: list[Passed] = []
    for baseline in (*baselines, *kept):
        check_comparable({"the method": method.scores, "the baseline": baseline.scores})
        policy = baseline.scores[0].policy_title
        if policy in seen:
            raise ConfigError(
                f"--baseline: {policy} is also the policy of the compared run, or of another --baseline; "
                "name one run per policy"
            )
        seen.add(policy)
        found.append(_passed(baseline.scores, method.scores))
    of_kept = found[len(baselines) :]
    rows = [
        *found[: len(baselines)],
        *(replace(row, role=role_in(k.scores)) for row, k in zip(of_kept, kept, strict=True)),
    ]
    return Baselines(
        method=_passed(method.scores, None),
        baselines=tuple(rows),
        floor=_floor(rows),
        kept=tuple(row.policy for row in of_kept),
    )


def _passed(scores: Sequence[TrialScore], method: Sequence[TrialScore] | None) -> Passed:
    """``method``: to which a baseline is compared; None for the method itself."""
    counted = judged(scores)
    tasks = sorted({s.task_id for s in (counted if method is None else judged(method))})
    counted = [s for s in counted if s.task_id in tasks]
    if not counted:
        raise ConfigError(
            f"--baseline: {scores[0].policy_title} ran none of the tasks {', '.join(tasks)}; run it on the same tasks"
        )
    every, counted = counted, _shared(counted, method)
    of_policy = Passed(
        policy=scores[0].policy_title,
        n=len(counted),
        seeds=len({s.seed for s in counted}),
        rates={rate.id: wilson_interval(_count(counted, rate), len(counted)) for rate in RATES},
        per_task={task: _of_task([s for s in counted if s.task_id == task]) for task in tasks},
    )
    if method is None:
        return replace(of_policy, role=role_in(scores))
    role = role_in(scores)
    named = replace(of_policy, role="blind" if role == "method" and scores[0].policy not in POLICIES else role)
    if len(every) > len(counted):
        named = replace(named, whole=wilson_interval(sum(s.safety_gated for s in every), len(every)))
    return _against(named, counted, judged(method))


def _shared(scores: Sequence[TrialScore], method: Sequence[TrialScore] | None) -> Sequence[TrialScore]:
    """The trials that the method has as well; all of them where there is none, or without a method."""
    keys = {} if method is None else trials_by_key(method)
    return [s for s in scores if (s.task_id, s.seed) in keys] or scores


def _floor(baselines: Sequence[Passed]) -> dict[str, BlindRate]:
    best: dict[str, BlindRate] = {}
    for row in baselines:
        if row.role != "blind":
            continue
        counts = {ALL: (row.rates["safety_gated"].k, row.n)} | {
            task: of_task["safety_gated"] for task, of_task in row.per_task.items()
        }
        for place, (k, n) in counts.items():
            raise_floor(best, place, row.policy, k, n)
    return best


def _against(found: Passed, scores: Sequence[TrialScore], method: Sequence[TrialScore]) -> Passed:
    of_method, of_baseline = trials_by_key(method), trials_by_key(scores)
    pairs = [(of_method[key], of_baseline[key]) for key in sorted(of_method.keys() & of_baseline.keys())]
    seeds = [{s.seed for s in trials} for trials in (method, scores)]
    paired = {s.seed for s, _ in pairs}
    return replace(
        found,
        n_pairs=len(pairs),
        method_passed=sum(of_method.safety_gated for of_method, _ in pairs),
        above_seeds=len(paired) if pairs else min(map(len, seeds)),
        above={rate.id: _difference(rate, pairs, method, scores) for rate in RATES},
    )


def _of_task(scores: Sequence[TrialScore]) -> dict[str, tuple[int, int]]:
    return {rate.id: (_count(scores, rate), len(scores)) for rate in RATES}


def _difference(
    rate: Outcome,
    pairs: Sequence[tuple[TrialScore, TrialScore]],
    method: Sequence[TrialScore],
    baseline: Sequence[TrialScore],
) -> RateDifference:
    if not pairs:
        return unpaired_difference(_count(method, rate), len(method), _count(baseline, rate), len(baseline))
    both, only_method, only_baseline, neither = (
        sum((bool(rate.of(m)), bool(rate.of(b))) == want for m, b in pairs)
        for want in ((True, True), (True, False), (False, True), (False, False))
    )
    return paired_difference(both=both, only_first=only_method, only_second=only_baseline, neither=neither)


def _count(scores: Sequence[TrialScore], rate: Outcome) -> int:
    return sum(bool(rate.of(score)) for score in scores)
