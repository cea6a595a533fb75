"""Two runs of one protocol side by side, trial by trial: what differs, and what could not have been seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from carecontact import __version__
from carecontact.errors import ConfigError
from carecontact.reports.table import angle, number
from carecontact.scoring.metric import METRICS
from carecontact.scoring.result import TrialScore
from carecontact.scoring.run import RunScores, check_one_run, judged, world_difference
from carecontact.stats import (
    BootstrapDifference,
    DetectableDifference,
    FisherExact,
    MannWhitney,
    McNemar,
    Median,
    Proportion,
    RateDifference,
    SignedRank,
    WorstRank,
    clustered_bootstrap,
    detectable_from_standard_error,
    fisher_exact,
    holm,
    mann_whitney,
    mcnemar_exact,
    median,
    paired_detectable_difference,
    paired_difference,
    signed_rank,
    wilson_interval,
    worst_rank_paired,
)

COMPARISON_SCHEMA = "carecontact-comparison-1"
ALPHA = 0.05
"""Of the whole family."""
POWER = 0.8
FEW_SEEDS = 5
"""Below this many seeds the bootstrap's standard error says nothing."""

Word = Literal["A higher", "B higher", "no difference seen", "underpowered"]
Pair = tuple[TrialScore, TrialScore]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    id: str
    title: str
    unit: str
    """Of values and differences as they are printed."""
    better: Literal["higher", "lower"]
    field: str
    matters: float
    """A comparison that could have missed a difference of this size is underpowered; reasons in docs/statistics.md."""
    push_only: bool = False

    @property
    def is_rate(self) -> bool:
        return self.unit == "%"


def _score(metric: str, field: str, matters: float, *, push_only: bool = False) -> Outcome:
    row = METRICS[metric]
    return Outcome(
        id=metric.partition("@")[0],
        title=row.title,
        unit=row.unit,
        better=row.better,
        field=field,
        matters=matters,
        push_only=push_only,
    )


RATES = tuple(
    Outcome(id=id_, title=title, unit="%", better="higher", field=field, matters=0.2)
    for id_, title, field in (
        ("success", "Success", "c3_success"),
        ("region_correct", "Region-correct", "region_correct"),
        ("safety_gated", "Safety-gated", "safety_gated"),
    )
)
SCORES = (
    _score("C1@1", "c1_peak_force_n", 5.0),
    _score("C2@1", "c2_joint_margin_rad", 0.05, push_only=True),
    _score("C4@1", "c4_motion_activity", 0.1),
    _score("C5@1", "c5_force_sd_n", 1.0),
)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    word: Word
    text: str
    """The word and what it rests on."""


@dataclass(frozen=True, kw_only=True)
class RateLine:
    """Differences are A minus B, as fractions."""

    outcome: Outcome
    n_pairs: int
    a: Proportion
    b: Proportion
    difference: RateDifference
    clustered: BootstrapDifference
    """The same difference with an interval that keeps a seed's tasks together."""
    test: McNemar
    unpaired_a: Proportion
    """Over every trial of the tasks that both runs have, paired or not."""
    unpaired_b: Proportion
    unpaired: FisherExact
    p_holm: float | None = None
    detectable: DetectableDifference | None = None
    verdict: Verdict | None = None
    notes: tuple[str, ...] = ()

    @property
    def favours(self) -> int:
        """1 where A is higher in more pairs, -1 where B is, else 0."""
        return _sign(self.test.only_first - self.test.only_second)


@dataclass(frozen=True, kw_only=True)
class ScoreLine:
    """Differences are A minus B, in the outcome's unit."""

    outcome: Outcome
    n_pairs: int
    a: Median
    """Over the paired trials in which the score exists."""
    b: Median
    n_only_a: int
    """Pairs in which A alone has the score."""
    n_only_b: int
    n_neither: int
    difference: BootstrapDifference
    """Median of the differences, over pairs in which both have the score."""
    test: SignedRank
    worst_rank: WorstRank
    """Over all pairs; no score is the worst score."""
    unpaired_a: Median
    unpaired_b: Median
    unpaired: MannWhitney | None
    """None where a run has no value."""
    worst_rank_p_holm: float | None = None
    p_holm: float | None = None
    detectable: DetectableDifference | None = None
    verdict: Verdict | None = None
    notes: tuple[str, ...] = ()

    @property
    def favours(self) -> int:
        """1 where the ranks of A's larger values outweigh, -1 where B's do, else 0."""
        return _sign(self.test.rank_sum_first - self.test.rank_sum_second)


Line = RateLine | ScoreLine


@dataclass(frozen=True, kw_only=True)
class Pairing:
    n: int
    seeds: tuple[int, ...]
    tasks: tuple[str, ...]
    unpaired_a: dict[str, str]
    """Trial that has no partner -> why B lacks it."""
    unpaired_b: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    policy: str
    language_backend: tuple[str, ...]
    n_trials: int
    """That say something about the policy."""
    n_harness_errors: int
    skipped: dict[str, str]
    versions: dict[str, list[str]]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    protocol_id: str
    protocol_sha256: str
    overrides: dict[str, str]
    metric_versions: dict[str, str]
    a: RunInfo
    b: RunInfo
    pairing: Pairing
    overall: tuple[Line, ...]
    """One family for Holm."""
    per_task: dict[str, tuple[Line, ...]] | None
    """Task -> its lines, all tasks one further family; None unless asked for."""


def compare_runs(a: RunScores, b: RunScores, *, per_task: bool = False) -> Comparison:
    """Pair the trials of two runs by task and seed and compare everything that is scored.

    Trials in which the harness failed are in no pair and no count. Raises ConfigError, naming what differs, if the
    runs must not be compared: another protocol, overrides, definitions or world, or no task and seed in common.
    """
    _check_comparable(a.scores, b.scores)
    of_a, of_b = _by_task_and_seed(a.scores), _by_task_and_seed(b.scores)
    keys = sorted(of_a.keys() & of_b.keys())
    if not keys:
        raise ConfigError(
            f"no task and seed is in both runs: A has {_told(of_a)}; B has {_told(of_b)}; run the same seeds of a task"
        )
    pairs = [(of_a[key], of_b[key]) for key in keys]
    tasks = tuple(sorted({task for task, _ in keys}))
    every_a = [s for s in of_a.values() if s.task_id in tasks]
    every_b = [s for s in of_b.values() if s.task_id in tasks]
    lines = None
    if per_task:
        found = {
            task: _lines(
                [p for p in pairs if p[0].task_id == task],
                [s for s in every_a if s.task_id == task],
                [s for s in every_b if s.task_id == task],
            )
            for task in tasks
        }
        concluded = iter(_conclude([line for group in found.values() for line in group]))
        lines = {task: tuple(next(concluded) for _ in group) for task, group in found.items()}
    first = a.scores[0]
    return Comparison(
        protocol_id=first.protocol_id,
        protocol_sha256=first.protocol_sha256,
        overrides=first.overrides,
        metric_versions=first.metric_versions,
        a=_info(a),
        b=_info(b),
        pairing=Pairing(
            n=len(pairs),
            seeds=tuple(sorted({seed for _, seed in keys})),
            tasks=tasks,
            unpaired_a=_without_partner(of_a, of_b, b),
            unpaired_b=_without_partner(of_b, of_a, a),
        ),
        overall=tuple(_conclude(_lines(pairs, every_a, every_b))),
        per_task=lines,
    )


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """The content of ``comparison.json``. Rates and their differences are fractions; infinity and NaN are null."""
    content = {
        "schema": COMPARISON_SCHEMA,
        "carecontact": __version__,
        "alpha": ALPHA,
        "power": POWER,
        **asdict(comparison),
    }
    return {key: _plain(value) for key, value in content.items()}


def plain_text(outcome: Outcome, value: float | None) -> str:
    """As many digits as the tables give the outcome, without the unit; rates in percent."""
    if outcome.unit == "%":
        return number(None if value is None else 100 * value, 1)
    return angle(value) if outcome.unit == "rad" else number(value, 3 if outcome.unit == "1" else 2)


def _check_comparable(a: Sequence[TrialScore], b: Sequence[TrialScore]) -> None:
    for name, scores in (("A", a), ("B", b)):
        check_one_run(scores)
        if not judged(scores):
            raise ConfigError(f"run {name} has no trial that says anything about its policy; compare scored runs")
    first, other = a[0], b[0]
    if first.protocol_sha256 != other.protocol_sha256 or first.overrides != other.overrides:
        told = [f"{s.protocol_title} ({s.protocol_sha256[:12]})" for s in (first, other)]
        raise ConfigError(
            f"A ran {told[0]}, B ran {told[1]}: only runs of one protocol, same overrides, can be compared"
        )
    if first.metric_versions != other.metric_versions:
        keys = sorted(
            key
            for key in first.metric_versions.keys() | other.metric_versions.keys()
            if first.metric_versions.get(key) != other.metric_versions.get(key)
        )
        told = ", ".join(f"{k} {first.metric_versions.get(k)} and {other.metric_versions.get(k)}" for k in keys)
        raise ConfigError(f"A and B are scored by different definitions ({told}): score both again with one release")
    found = world_difference([*judged(a), *judged(b)])
    if found is not None:
        what, one, two = found
        raise ConfigError(
            f"A and B are of different worlds: {what} {one.world[what][:12]} ({one.trial_id} of A) and "
            f"{two.world[what][:12]} ({two.trial_id} of B); run both with one release and one robot"
        )


def _by_task_and_seed(scores: Iterable[TrialScore]) -> dict[tuple[str, int], TrialScore]:
    return {(s.task_id, s.seed): s for s in judged(scores)}


def _told(trials: Mapping[tuple[str, int], TrialScore]) -> str:
    tasks, seeds = sorted({task for task, _ in trials}), sorted({seed for _, seed in trials})
    more = ", ..." if len(seeds) > 8 else ""
    return f"{', '.join(tasks)} with seeds {', '.join(map(str, seeds[:8]))}{more}"


def _without_partner(
    trials: Mapping[tuple[str, int], TrialScore], others: Mapping[tuple[str, int], TrialScore], other: RunScores
) -> dict[str, str]:
    failed = {(s.task_id, s.seed) for s in other.scores if not s.is_judged}
    return {
        trials[key].trial_id: "harness failed"
        if key in failed
        else "recording skipped"
        if f"{trials[key].trial_id}.h5" in other.skipped
        else "not in the run"
        for key in sorted(trials.keys() - others.keys())
    }


def _info(run: RunScores) -> RunInfo:
    counted = judged(run.scores)
    return RunInfo(
        policy=counted[0].policy,
        language_backend=tuple(sorted({s.language_backend for s in counted})),
        n_trials=len(counted),
        n_harness_errors=len(run.scores) - len(counted),
        skipped=run.skipped,
        versions=run.versions,
    )


def _lines(pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]) -> list[Line]:
    lines: list[Line] = [_rate_line(outcome, pairs, every_a, every_b) for outcome in RATES]
    for outcome in SCORES:
        kept = [p for p in pairs if p[0].action == "push"] if outcome.push_only else pairs
        if kept:
            of_a = [s for s in every_a if s.action == "push" or not outcome.push_only]
            of_b = [s for s in every_b if s.action == "push" or not outcome.push_only]
            lines.append(_score_line(outcome, kept, of_a, of_b))
    return lines


def _rate_line(
    outcome: Outcome, pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]
) -> RateLine:
    a, b = [bool(getattr(x, outcome.field)) for x, _ in pairs], [bool(getattr(y, outcome.field)) for _, y in pairs]
    only_a = sum(x and not y for x, y in zip(a, b, strict=True))
    only_b = sum(y and not x for x, y in zip(a, b, strict=True))
    both = sum(a) - only_a
    k_a, k_b = (sum(bool(getattr(s, outcome.field)) for s in every) for every in (every_a, every_b))
    return RateLine(
        outcome=outcome,
        n_pairs=len(pairs),
        a=wilson_interval(sum(a), len(a)),
        b=wilson_interval(sum(b), len(b)),
        difference=paired_difference(
            both=both, only_first=only_a, only_second=only_b, neither=len(a) - both - only_a - only_b
        ),
        clustered=clustered_bootstrap(a, b, clusters=[x.seed for x, _ in pairs], statistic="difference_of_means"),
        test=mcnemar_exact(only_a, only_b),
        unpaired_a=wilson_interval(k_a, len(every_a)),
        unpaired_b=wilson_interval(k_b, len(every_b)),
        unpaired=fisher_exact(k_a, len(every_a), k_b, len(every_b)),
    )


def _score_line(
    outcome: Outcome, pairs: Sequence[Pair], every_a: Sequence[TrialScore], every_b: Sequence[TrialScore]
) -> ScoreLine:
    def values(scores: Iterable[TrialScore]) -> list[float | None]:
        return [getattr(s, outcome.field) for s in scores]

    a, b = values(x for x, _ in pairs), values(y for _, y in pairs)
    all_a, all_b = values(every_a), values(every_b)
    valid_a, valid_b = ([v for v in found if v is not None] for found in (all_a, all_b))
    worst = worst_rank_paired(a, b, better=outcome.better)
    return ScoreLine(
        outcome=outcome,
        n_pairs=len(pairs),
        a=median(a),
        b=median(b),
        n_only_a=worst.n_only_first,
        n_only_b=worst.n_only_second,
        n_neither=sum(x is None and y is None for x, y in zip(a, b, strict=True)),
        difference=clustered_bootstrap(a, b, clusters=[x.seed for x, _ in pairs]),
        test=signed_rank(a, b),
        worst_rank=worst,
        unpaired_a=median(all_a),
        unpaired_b=median(all_b),
        unpaired=mann_whitney(valid_a, valid_b) if valid_a and valid_b else None,
    )


def _conclude(lines: Sequence[Line]) -> list[Line]:
    """With p-values adjusted over the family, what could have been detected, and a verdict for each."""
    adjusted = holm([line.test.pvalue for line in lines])
    worst = holm([line.worst_rank.pvalue if isinstance(line, ScoreLine) else None for line in lines])
    # What Holm asks of the smallest p-value: the only level that a line is sure to be tested at.
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
    """None where too few seeds make a guess of it."""
    if isinstance(line, RateLine):
        discordance = (line.test.only_first + line.test.only_second) / line.n_pairs
        return paired_detectable_difference(n=line.n_pairs, discordance=discordance, power=POWER, alpha=alpha)
    # Even if all pairs differed the same way, the signed-rank test would give 2 / 2^n.
    if 2.0 ** (1 - line.test.n) > alpha:
        return DetectableDifference(difference=None, power=POWER, alpha=alpha)
    if line.difference.standard_error is None or line.difference.n_clusters < FEW_SEEDS:
        return None
    return detectable_from_standard_error(line.difference.standard_error, power=POWER, alpha=alpha)


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
        why = f"from {_seeds(line)} nobody can tell what could have been detected"
    elif detectable.difference is None:
        why = "this comparison could not have detected any difference"
    else:
        unit = {"%": " points", "1": ""}.get(outcome.unit, f" {outcome.unit}")
        size = f"{plain_text(outcome, detectable.difference)}{unit}"
        if detectable.difference <= outcome.matters:
            return Verdict(
                word="no difference seen",
                text=f"no difference seen; one of {size} would have been, with {POWER:.0%} power",
            )
        why = f"this comparison could not have detected a difference below {size}"
    return Verdict(word="underpowered", text=f"underpowered: {why}")


def _better(line: Line) -> int:
    """1 where the paired test favours A, -1 where it favours B, else 0."""
    return line.favours if line.outcome.better == "higher" else -line.favours


def _notes(line: Line) -> list[str]:
    """Where another way of looking says something else."""
    assert line.verdict is not None
    notes: list[str] = []
    decided = line.verdict.word in ("A higher", "B higher")
    interval = line.clustered if isinstance(line, RateLine) else line.difference
    if decided and interval.low is not None and interval.high is not None and interval.low <= 0 <= interval.high:
        notes.append("an interval that keeps a seed's tasks together does not exclude 0")
    if isinstance(line, ScoreLine) and line.worst_rank_p_holm is not None and line.worst_rank_p_holm <= ALPHA:
        side = {"first": 1, "second": -1, "neither": 0}[line.worst_rank.better]
        if side and not (decided and side == _better(line)):
            notes.append(f"with no score counted as the worst score {'A' if side > 0 else 'B'} is better")
    return notes


def _seeds(line: Line) -> str:
    n = line.clustered.n_clusters if isinstance(line, RateLine) else line.difference.n_clusters
    return f"{n} seed{'s' * (n != 1)}"


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value
