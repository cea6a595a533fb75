"""What baselines pass beside a method: the floor under its rates.

A blind baseline is a policy that cannot do a task, because it does not look, touch or decide. Each of its successes is
a false positive of the gates. Beside them may stand a privileged policy, whose rate is the ceiling, and probes, which
change one thing about a method. None of them is ever ranked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from carecontact.errors import ConfigError
from carecontact.policies.registry import POLICIES, Role
from carecontact.reports.compare.blind_floor import FloorRate, floor_of, role_in
from carecontact.reports.compare.comparable import check_comparable, check_complete, machines_text, trials_by_key
from carecontact.reports.compare.outcomes import RATES, Outcome
from carecontact.reports.over_seeds import Over, difference_of, over_of, rate_of
from carecontact.runs.pooling import judged, rejected_text, share, task_of
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, RateDifference, difference_of_rates


@dataclass(frozen=True, kw_only=True)
class Passed:
    """What one policy passed.

    Rates by id: ``success``, ``region_correct``, ``safety_gated``. Those of a baseline are over the trials (task and
    seed) that the method has as well, or, where there is none, over all of its trials of the method's tasks.
    """

    policy: str
    n: int
    """Trials that the rates are over; harness errors are left out."""
    unknown: int
    """Planned trials of the same tasks that have no verdict; for an incomplete run, each rate is open by as many."""
    seeds: int
    """Different seeds of these trials."""
    rates: dict[str, Proportion]
    """Rate -> its value. Of a baseline, these are false positives."""
    per_task: dict[str, dict[str, tuple[int, int]]]
    """Task -> rate -> count and number of trials."""
    role: Role = "method"
    """The policy's role as registered. A policy that nobody registered is a method, even where it is named as a
    baseline."""
    n_pairs: int | None = None
    """Trials of the same task and seed in both; None for the method itself."""
    method_passed: int | None = None
    """How many of these trials the method passed safely (safety-gated); None for the method itself."""
    whole: Proportion | None = None
    """Safety-gated rate of a baseline over all of its trials of the method's tasks, where ``rates`` leave out some of
    them; None otherwise."""
    above_seeds: int | None = None
    """Different seeds that the differences rest on: those of the pairs or, without any, of the run that has fewer; None
    for the method itself."""
    above: dict[str, RateDifference] | None = None
    """Method minus baseline, as fractions: by pairs, or between independent trials where there is no pair."""

    @property
    def trials(self) -> str:
        """``18``, or ``15 of 18`` where planned trials have no verdict."""
        return f"{self.n} of {self.n + self.unknown}" if self.unknown else str(self.n)

    def count(self, rate: str) -> str:
        """Return a rate as ``9 of 18``, or ``9 to 12 of 18`` where three planned trials have no verdict."""
        return share(self.rates[rate].k, self.rates[rate].n, self.unknown)


@dataclass(frozen=True, kw_only=True)
class Baselines:
    """Baselines beside a method."""

    method: Passed
    over: Over
    """What intervals take as independent: the trials, or the seeds."""
    machines: str = ""
    """What computed and drew the runs, where it differs; else empty."""
    protocol: str = ""
    """Title of the protocol of all of them."""
    rejected_tissue: str = ""
    """A sentence for runs on a tissue whose calibration was rejected; else empty."""
    baselines: tuple[Passed, ...]
    floor: dict[str, FloorRate] = field(default_factory=dict[str, FloorRate])
    """``all`` and each task -> the safety-gated rate of the baseline that passes most there, of those that are blind or
    that nobody registered; registered methods count only where there is no other."""
    kept: tuple[str, ...] = ()
    """The policies among ``baselines`` whose scores are kept with the package; some of them may be methods that see."""
    completed: tuple[str, ...] = ()
    """Named ones of ``baselines`` whose run lacks trials that are kept with the package, and that have those here."""

    @property
    def tasks(self) -> tuple[str, ...]:
        return tuple(self.method.per_task)

    @property
    def only_blind(self) -> bool:
        """Whether a blind baseline and no method stand among them; beside it, ceilings and probes that are named so."""
        roles = {row.role for row in self.baselines}
        return "blind" in roles and "method" not in roles


def beside_baselines(
    method: RunScores,
    baselines: Sequence[RunScores],
    *,
    kept: Sequence[RunScores] = (),
    allow_incomplete: bool = False,
) -> Baselines:
    """Set baselines beside a method, over the trials that both have (``Passed``).

    A method may be named as a baseline; it does not become blind by that. ``kept`` are scores that are kept with the
    package.

    Intervals of rates and differences are over what the protocol takes as independent (``over_of``). Raises
    ConfigError as ``check_baselines`` does.
    """
    check_baselines(method, [*baselines, *kept], allow_incomplete=allow_incomplete)
    found = [_passed(baseline, method.scores) for baseline in (*baselines, *kept)]
    if method.incomplete:
        # A difference would be over fewer trials than were planned.
        found = [replace(row, above=None) for row in found]
    methods = [run for run in baselines if role_in(run.scores) == "method"]
    blind = [run for run in (*baselines, *kept) if role_in(run.scores) == "blind"]
    # Somebody's own blind baseline may have no row that says so.
    floor = [*blind, *(run for run in methods if run.scores[0].policy not in POLICIES)] or methods
    return Baselines(
        method=_passed(method, None),
        over=over_of(method.scores[0]),
        machines=machines_text({run.scores[0].policy_title: run.scores for run in (method, *baselines, *kept)}),
        protocol=method.scores[0].protocol_title,
        rejected_tissue=rejected_text(method.scores),
        baselines=tuple(found),
        floor=floor_of(_comparable(run.scores, method.scores) for run in floor),
        kept=tuple(row.policy for row in found[len(baselines) :]),
    )


def check_baselines(method: RunScores, baselines: Sequence[RunScores], *, allow_incomplete: bool = False) -> None:
    """Raise ConfigError, which names what differs, for a baseline that cannot stand beside a method: one of another
    protocol, with other overrides or definitions or of another world; the method itself; one that is named twice; one
    without a task in common; or, unless these are allowed, one of which planned trials have no verdict."""
    seen = {method.scores[0].policy_title} if method.scores else set[str]()
    for baseline in baselines:
        check_comparable({"the method": method.scores, "the baseline": baseline.scores})
        if not allow_incomplete:
            check_complete({f"--baseline: {baseline.scores[0].policy_title}": baseline})
        policy = baseline.scores[0].policy_title
        if policy in seen:
            raise ConfigError(
                f"--baseline: {policy} is also the policy of the compared run, or of another --baseline; "
                "name one run per policy"
            )
        seen.add(policy)
        _of_tasks(baseline.scores, method.scores)


def _passed(run: RunScores, method: Sequence[TrialScore] | None) -> Passed:
    """``method``: to which a baseline is compared; None for the method itself, whose tasks without any verdict count as
    unknown, too."""
    scores = run.scores
    every = _of_tasks(scores, scores if method is None else method)
    counted = every if method is None else _shared(every, method)
    tasks = sorted({s.task_id for s in (counted if method is None else judged(method))})
    found = Passed(
        policy=scores[0].policy_title,
        n=len(counted),
        unknown=sum(method is None or task_of(trial) in tasks for trial in run.unjudged),
        seeds=len({s.seed for s in counted}),
        rates={rate.id: rate_of(counted, rate.field) for rate in RATES},
        per_task={task: _of_task([s for s in counted if s.task_id == task]) for task in tasks},
        role=role_in(scores),
        whole=rate_of(every, "safety_gated") if len(every) > len(counted) else None,
    )
    return found if method is None else _against(found, counted, judged(method))


def _comparable(scores: Sequence[TrialScore], method: Sequence[TrialScore]) -> Sequence[TrialScore]:
    """Return the trials that the rates of a baseline are over."""
    return _shared(_of_tasks(scores, method), method)


def _of_tasks(scores: Sequence[TrialScore], method: Sequence[TrialScore]) -> list[TrialScore]:
    """Return the judged trials of the method's tasks. Raises ConfigError where there is none."""
    tasks = sorted({s.task_id for s in judged(method)})
    counted = [s for s in judged(scores) if s.task_id in tasks]
    if not counted:
        raise ConfigError(
            f"--baseline: {scores[0].policy_title} ran none of the tasks {', '.join(tasks)}; run it on the same tasks"
        )
    return counted


def _shared(scores: Sequence[TrialScore], method: Sequence[TrialScore]) -> Sequence[TrialScore]:
    """Return the trials that the method has as well; all of them where there is none."""
    keys = trials_by_key(method)
    return [s for s in scores if (s.task_id, s.seed) in keys] or scores


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
    return {rate.id: (sum(bool(rate.of(s)) for s in scores), len(scores)) for rate in RATES}


def _difference(
    rate: Outcome,
    pairs: Sequence[tuple[TrialScore, TrialScore]],
    method: Sequence[TrialScore],
    baseline: Sequence[TrialScore],
) -> RateDifference:
    if not pairs:
        return difference_of_rates(rate_of(method, rate.field), rate_of(baseline, rate.field))
    return difference_of([m for m, _ in pairs], [b for _, b in pairs], rate.field)[0]
