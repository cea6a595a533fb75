"""The baselines that stand beside a run: the blind floor, the ceiling, and the scores shipped with the package."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from carecontact.errors import CarecontactError, ConfigError
from carecontact.policies.registry import POLICIES, Role, role_of
from carecontact.report.comparison import check_comparable, check_complete, machines_text, trials_by_key
from carecontact.report.paired import RATES, difference_of
from carecontact.runs.pooling import Over, RunScores, judged, over_of, rate_of, rejected_text, share, task_of
from carecontact.runs.scoring import read_scores
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, RateDifference, difference_of_rates, wilson_interval

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


def floor_of(baselines: Iterable[Sequence[TrialScore]]) -> dict[str, FloorRate]:
    """ALL and each task -> the best rate there; of equal ones, that with more success before safety, or the first.

    Args:
        baselines: judged trials of each, one at least.
    """
    best: dict[str, tuple[tuple[float, float], FloorRate]] = {}
    for scores in baselines:
        for place in (ALL, *sorted({score.task_id for score in scores})):
            there = [score for score in scores if place in (ALL, score.task_id)]
            rate, success = (rate_of(there, field) for field in ("safety_gated", "c3_success"))
            passed = rate.k / rate.n, success.k / rate.n
            if place not in best or passed > best[place][0]:
                blind = role_in(scores) == "blind"
                best[place] = passed, FloorRate(policy=scores[0].policy_title, blind=blind, rate=rate)
    return {place: rate for place, (_, rate) in best.items()}


# What baselines pass beside a method: the floor under its rates.
#
# A blind baseline is a policy that cannot do a task, because it does not look, touch or decide. Each of its successes
# is a false positive of the gates. Beside them may stand a privileged policy, whose rate is the ceiling, and probes,
# which change one thing about a method. None of them is ever ranked.


@dataclass(frozen=True, kw_only=True)
class Passed:
    """What one policy passed. Rates of a baseline are over the trials (task and seed) that the method has as well, or,
    where there is none, over all of its trials of the method's tasks."""

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
    """The policy's role as registered. An unregistered policy is a method, even where it is named as a
    baseline."""
    n_pairs: int | None = None
    """Trials of the same task and seed in both; None for the method itself."""
    method_passed: int | None = None
    """How many of these trials are safety-gated for the method."""
    whole: Proportion | None = None
    """Safety-gated rate over all trials of the method's tasks, where ``rates`` leave out some of them."""
    above_seeds: int | None = None
    """Seeds that the differences rest on: those of the pairs or, without any, of the run that has fewer."""
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
    that are not registered; registered methods count only where there is no other."""
    kept: tuple[str, ...] = ()
    """The policies among ``baselines`` whose scores are kept with the package; some of them may be methods that see."""
    completed: tuple[str, ...] = ()
    """Named ones of ``baselines`` whose run lacks trials that are kept with the package, and that have those here."""

    @property
    def tasks(self) -> tuple[str, ...]:
        return tuple(self.method.per_task)

    def ceiling(self, place: str) -> FloorRate | None:
        """Return the best safety-gated rate of a privileged policy in ALL or in one task; None without any."""
        best: FloorRate | None = None
        for row in self.baselines:
            gated = row.rates["safety_gated"]
            k, n = (gated.k, row.n) if place == ALL else row.per_task.get(place, {}).get("safety_gated", (0, 0))
            if row.role == "privileged" and n and (best is None or k / n > best.rate.k / best.rate.n):
                best = FloorRate(policy=row.policy, blind=False, rate=wilson_interval(k, n))
        return best

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
    """Set baselines beside a method, over the trials that both have; ``kept``: scores from the package.

    A method that is named as a baseline does not become blind by that. Raises ConfigError as ``check_baselines``.
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
        floor=floor_of(_shared(_of_tasks(run.scores, method.scores), method.scores) for run in floor),
        kept=tuple(row.policy for row in found[len(baselines) :]),
    )


def check_baselines(method: RunScores, baselines: Sequence[RunScores], *, allow_incomplete: bool = False) -> None:
    """A baseline may have another controller: a policy of joint angles has no blind baseline under its own.

    Raises ConfigError for a baseline that is not comparable, named twice, or the method itself, that has no task in
    common, or, unless these are allowed, of which planned trials have no verdict."""
    seen = {method.scores[0].policy_title} if method.scores else set[str]()
    for baseline in baselines:
        titled = f"the baseline ({baseline.scores[0].policy_title})" if baseline.scores else "the baseline"
        check_comparable({"the method": method.scores, titled: baseline.scores}, but={"control"})
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
    """``method``: None for the method itself, whose tasks without any verdict count as unknown, too."""
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
        per_task={
            task: {rate.id: (sum(bool(rate.of(s)) for s in of_task), len(of_task)) for rate in RATES}
            for task in tasks
            for of_task in [[s for s in counted if s.task_id == task]]
        },
        role=role_in(scores),
        whole=rate_of(every, "safety_gated") if len(every) > len(counted) else None,
    )
    return found if method is None else _against(found, counted, judged(method))


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
    if pairs:
        first, second = ([pair[side] for pair in pairs] for side in (0, 1))
        above = {rate.id: difference_of(first, second, rate.field)[0] for rate in RATES}
        seeds = len({s.seed for s in first})
    else:
        above = {
            rate.id: difference_of_rates(rate_of(method, rate.field), rate_of(scores, rate.field)) for rate in RATES
        }
        seeds = min(len({s.seed for s in trials}) for trials in (method, scores))
    passed = sum(trial.safety_gated for trial, _ in pairs)
    return replace(found, n_pairs=len(pairs), method_passed=passed, above_seeds=seeds, above=above)


PACKAGE = Path(__file__).parents[1]
FOLDERS = (PACKAGE / "assets" / "results", PACKAGE.parents[1] / "docs" / "results")
"""The folders in which ``tools/keep_sweep.py`` leaves kept scores, with a folder for each protocol: in the package, or
in the clone that it is installed from."""


def beside_shipped_scores(
    run: RunScores, named: Sequence[RunScores], *, folders: Sequence[Path] = FOLDERS
) -> tuple[Baselines | None, str]:
    """Return the named baselines and the kept scores beside a run (of one trial of one policy, the named one), None
    without any, and why no kept scores are among them. Raises ConfigError as ``check_baselines``."""
    check_baselines(run, named)
    whole = [completed_from_shipped_scores(run, one, folders=folders) for one in named]
    kept, why = shipped_scores_for(run, whole, folders=folders)
    if not whole and not kept:
        return None, why
    completed = [one.scores[0].policy_title for one, given in zip(whole, named, strict=True) if one is not given]
    found = beside_baselines(run, whole, kept=kept)
    return replace(found, completed=tuple(completed)), "" if kept else why


def completed_from_shipped_scores(run: RunScores, named: RunScores, *, folders: Sequence[Path] = FOLDERS) -> RunScores:
    """Return a named baseline with the kept trials of the same policy that it has not."""
    for file in _files(run.scores[0].protocol_id, folders) if run.scores else ():
        try:
            kept = read_scores(file).scores
            if kept[0].policy_title != named.scores[0].policy_title:
                continue
            taken = {s.trial_id for s in named.scores}
            further = [s for s in kept if s.trial_id not in taken]
            if not further:
                return named
            both = replace(named, scores=[*named.scores, *further])
            check_baselines(run, [both])
        except CarecontactError:
            continue
        return both
    return named


def shipped_scores_for(
    run: RunScores, named: Sequence[RunScores], *, folders: Sequence[Path] = FOLDERS
) -> tuple[list[RunScores], str]:
    """Return the kept scores that can stand beside a run and the named baselines, and why there are none."""
    if not run.scores:
        return [], ""
    taken = {run.scores[0].policy_title, *(other.scores[0].policy_title for other in named)}
    kept: list[RunScores] = []
    why = ""
    for file in _files(run.scores[0].protocol_id, folders):
        try:
            scores = read_scores(file)
            title = scores.scores[0].policy_title
            if title not in taken:
                check_baselines(run, [*named, *kept, scores])
                kept.append(scores)
        except CarecontactError as error:
            why = why or f"The kept scores of {file.name.partition('.')[0]} cannot stand beside this run: {error}."
    none = f"No scores of the shipped policies and the blind baselines are kept for {run.scores[0].protocol_id}."
    return kept, "" if kept else why or none


def _files(protocol_id: str, folders: Sequence[Path]) -> list[Path]:
    """Return one file for each registered policy; the folder of a level is PROTOCOL-LEVEL."""
    for folder in folders:
        found = [
            path
            for name in sorted(POLICIES)
            if (path := folder / protocol_id.replace(" ", "-") / f"{name}.json.gz").is_file()
        ]
        if found:
            return found
    return []
