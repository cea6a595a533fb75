"""Two runs beside each other: whether they can be compared, their differences, and what these say."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from carecontact import __version__
from carecontact.errors import ConfigError, counted
from carecontact.report.paired import Line, Over, RateLine, ScoreLine, Verdict, over_of, paired_lines, plain_text
from carecontact.report.words import listed
from carecontact.runs.pooling import (
    EFFECT,
    PROVENANCE,
    RunScores,
    check_one_run,
    check_ranked,
    judged,
    machines,
    rejected_text,
    world_difference,
    world_part,
)
from carecontact.runs.results_file import RESULTS_NAME
from carecontact.scoring.result import TrialScore
from carecontact.stats import (
    DetectableDifference,
    McNemar,
    detectable_from_standard_error,
    holm,
    paired_detectable_difference,
)


def plain(value: Any) -> Any:
    """Return the value as JSON can hold it: tuples become lists, infinity and NaN become None."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def document(schema: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a file of results."""
    return plain({"schema": schema, "carecontact": __version__, "alpha": ALPHA, "power": POWER, **content})


def check_different(places: Sequence[Path]) -> None:
    """Raises ConfigError for a run that is named twice, also once by its folder and once by the results in it."""
    folders = [path.resolve().parent if path.name == RESULTS_NAME else path.resolve() for path in places]
    twice = next((path for path, folder in zip(places, folders, strict=True) if folders.count(folder) > 1), None)
    if twice is not None:
        raise ConfigError(f"{twice} is given twice; name different runs")


def check_complete(runs: Mapping[str, RunScores], *, otherwise: str = "") -> None:
    """Raises ConfigError for a run with planned trials that have no verdict; ``otherwise``: what else the caller
    offers than to complete the run."""
    for name, run in runs.items():
        if run.incomplete:
            first, why = next(iter(run.unjudged.items()))
            reason = why.partition("\n")[0]
            raise ConfigError(
                f"{name} is {run.incomplete} (the first without: {first}, {reason}); {run.completing}{otherwise}"
            )


def check_comparable(runs: Mapping[str, Sequence[TrialScore]], *, but: Collection[str] = ()) -> None:
    """Raises ConfigError unless all ran one protocol in one world, were scored alike, and have a judged trial.

    Args:
        runs: name for messages, such as "run A" -> scores.
        but: parts of the world that may differ.
    """
    for name, scores in runs.items():
        check_one_run(scores)
        check_ranked(scores, f"{name}: ")
        if not judged(scores):
            raise ConfigError(
                f"{name} has no trial to compare: none is scored, or the harness failed in all of them; "
                "give its `carecontact run` command again"
            )
    (reference, scores), *others = runs.items()
    for name, other in others:
        _check_two(reference, scores, name, other, but)


def _check_two(
    name_a: str, a: Sequence[TrialScore], name_b: str, b: Sequence[TrialScore], but: Collection[str]
) -> None:
    first, other = a[0], b[0]
    if first.protocol_sha256 != other.protocol_sha256 or first.overrides != other.overrides:
        ran_a, ran_b = (f"{s.protocol_title} ({s.protocol_sha256[:12]})" for s in (first, other))
        raise ConfigError(
            f"{name_a} ran {ran_a}, {name_b} ran {ran_b}: "
            "only runs of the same protocol with the same overrides can be compared"
        )
    if first.metric_versions != other.metric_versions:
        keys = sorted(first.metric_versions.keys() | other.metric_versions.keys())
        versions = [(key, first.metric_versions.get(key), other.metric_versions.get(key)) for key in keys]
        differ = ", ".join(f"{key} {of_a} and {of_b}" for key, of_a, of_b in versions if of_a != of_b)
        raise ConfigError(
            f"{name_a} and {name_b} are scored by different definitions ({differ}): score both again with one release"
        )
    found = world_difference([*judged(a), *judged(b)], but=but)
    if found is not None:
        what, one, two = found
        parts = [f"{world_part(s, what)} ({s.trial_id} of {name})" for s, name in ((one, name_a), (two, name_b))]
        where, remedy = {
            "salt": ("run on different persons", "the same --salt-file, or both without"),
        }.get(what, ("simulated in different worlds", "the same release, body, robot and controller"))
        differ = f"{what} {' and '.join(parts)}"
        raise ConfigError(f"{name_a} and {name_b} were {where}: {differ}; run both with {remedy}")


def machines_text(runs: Mapping[str, Sequence[TrialScore]]) -> str:
    """Return a sentence about what computed and drew comparable runs, where it differs; else empty."""
    parts: list[str] = []
    for part, title in PROVENANCE.items():
        names: dict[str, list[str]] = {}
        for name, scores in runs.items():
            names.setdefault(" and ".join(machines(judged(scores), part)), []).append(name)
        if len(names) > 1:
            parts.append(f"{title} {', '.join(f'{value} ({listed(held)})' for value, held in names.items())}")
    return f"These runs may come from different machines: {'; '.join(parts)}; {EFFECT}" if parts else ""


def trials_by_key(scores: Iterable[TrialScore]) -> dict[tuple[str, int], TrialScore]:
    """(task, seed) -> its trial, of those that are ``judged``."""
    return {(s.task_id, s.seed): s for s in judged(scores)}


ALPHA = 0.05
"""Level of significance of the whole family of tests."""
POWER = 0.8
FEW_SEEDS = 5
"""Below this many seeds the bootstrap's standard error says nothing."""


def conclude(lines: Sequence[Line]) -> list[Line]:
    """Return the lines with adjusted p-values, what could have been detected, and a verdict for each."""
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
    n = line.n_seeds if line.over == "seeds" else line.test.n
    if 2.0 ** (1 - n) > alpha:
        return DetectableDifference(difference=None, power=POWER, alpha=alpha)
    if isinstance(line, ScoreLine) and not line.test.n_unequal:
        return DetectableDifference(difference=0.0, power=POWER, alpha=alpha)
    if few_seeds(line):
        return None
    standard_error = line.interval.standard_error
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
        equal = "where so many pairs are equal that no resample moves the median,"
        why = f"{f'from {_seeds(line)}' if few_seeds(line) else equal} it is unknown what could have been detected"
    elif detectable.difference == 0:
        return Verdict(word="no difference detected", text="no difference detected; the pairs are equal")
    elif detectable.difference is None:
        why = "this comparison could not have detected any difference"
    else:
        unit = {"%": " points", "1": ""}.get(outcome.unit, f" {outcome.unit}")
        size = f"{plain_text(outcome, detectable.difference)}{unit}"
        if detectable.difference <= outcome.matters:
            text = f"no difference detected; a difference of {size} would have been detected with {POWER:.0%} power"
            return Verdict(word="no difference detected", text=text)
        why = f"this comparison could not have detected a difference below {size}"
    return Verdict(word="underpowered", text=f"underpowered: {why}")


def _notes(line: Line) -> list[str]:
    """Return notes where another way of looking at the data says something else."""
    assert line.verdict is not None
    notes: list[str] = []
    decided = line.verdict.word in ("A higher", "B higher")
    if decided and few_seeds(line):
        notes.append(f"based on only {_seeds(line)}")
    interval = line.interval
    if decided and interval.low is not None and interval.high is not None and interval.low <= 0 <= interval.high:
        notes.append(
            "its interval does not exclude 0"
            if line.over == "seeds"
            else "an interval that keeps a seed's tasks together does not exclude 0"
        )
    if isinstance(line, ScoreLine) and line.worst_rank_p_holm is not None and line.worst_rank_p_holm <= ALPHA:
        side = {"first": 1, "second": -1, "neither": 0}[line.worst_rank.better]
        better = line.favours if line.outcome.better == "higher" else -line.favours
        if side and not (decided and side == better):
            notes.append(f"with no score counted as the worst score {'A' if side > 0 else 'B'} is better")
    return notes


def few_seeds(line: Line) -> bool:
    """Whether there are so few seeds that neither an interval nor a standard error of theirs can be trusted."""
    return line.n_seeds < FEW_SEEDS


def _seeds(line: Line) -> str:
    return counted(line.n_seeds, "seed")


COMPARISON_SCHEMA = "carecontact-comparison-2"


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
    """Number of trials that say something about the policy, which excludes harness errors."""
    n_harness_errors: int
    n_planned: int
    skipped: dict[str, str]
    n_missing: int
    """Planned trials that were not scored, whatever the reason."""
    versions: dict[str, list[str]]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    protocol_id: str
    protocol_sha256: str
    overrides: dict[str, str]
    metric_versions: dict[str, str]
    a: RunInfo
    b: RunInfo
    over: Over
    """What intervals of rates, and paired tests, take as independent: the trials, or the seeds."""
    pairing: Pairing
    overall: tuple[Line, ...]
    """One family for Holm."""
    machines: str
    """What computed and drew the runs, where it differs; else empty."""
    rejected_tissue: str
    """A sentence for runs on a tissue whose calibration was rejected; else empty."""
    per_task: dict[str, tuple[Line, ...]] | None
    """Task -> its lines, all tasks one further family; None unless requested."""

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``comparison.json``. Rates and their differences are fractions; infinity and NaN are
        null."""
        return document(COMPARISON_SCHEMA, asdict(self))


def compare_runs(a: RunScores, b: RunScores, *, per_task: bool = False, allow_incomplete: bool = False) -> Comparison:
    """Pair the trials of two runs by task and seed and compare everything that is scored.

    Args:
        allow_incomplete: whether to compare runs of which planned trials have no verdict; these are in no pair and no
            count.

    Raises ConfigError, naming what differs, if the runs must not be compared: another protocol, overrides, definitions
    or world, an incomplete run, or no task and seed in common.
    """
    if not allow_incomplete:
        check_complete({"A": a, "B": b}, otherwise=", or compare with allow_incomplete=True")
    check_comparable({"run A": a.scores, "run B": b.scores})
    of_a, of_b = trials_by_key(a.scores), trials_by_key(b.scores)
    keys = sorted(of_a.keys() & of_b.keys())
    if not keys:
        raise ConfigError(
            f"A and B have no trial (task and seed) in common: A has {_tasks_and_seeds(of_a)}; "
            f"B has {_tasks_and_seeds(of_b)}; run the same seeds of a task"
        )
    pairs = [(of_a[key], of_b[key]) for key in keys]
    tasks = tuple(sorted({task for task, _ in keys}))
    every_a = [s for s in of_a.values() if s.task_id in tasks]
    every_b = [s for s in of_b.values() if s.task_id in tasks]
    lines = None
    if per_task:
        found = {
            task: paired_lines(
                [p for p in pairs if p[0].task_id == task],
                [s for s in every_a if s.task_id == task],
                [s for s in every_b if s.task_id == task],
            )
            for task in tasks
        }
        concluded = iter(conclude([line for group in found.values() for line in group]))
        lines = {task: tuple(next(concluded) for _ in group) for task, group in found.items()}
    first = a.scores[0]
    return Comparison(
        protocol_id=first.protocol_id,
        protocol_sha256=first.protocol_sha256,
        overrides=first.overrides,
        metric_versions=first.metric_versions,
        a=_info(a),
        b=_info(b),
        over=over_of(first),
        pairing=Pairing(
            n=len(pairs),
            seeds=tuple(sorted({seed for _, seed in keys})),
            tasks=tasks,
            unpaired_a=_without_partner(of_a, of_b, b),
            unpaired_b=_without_partner(of_b, of_a, a),
        ),
        rejected_tissue=rejected_text(a.scores),
        machines=machines_text({"A": a.scores, "B": b.scores}),
        overall=tuple(conclude(paired_lines(pairs, every_a, every_b))),
        per_task=lines,
    )


def _tasks_and_seeds(trials: Mapping[tuple[str, int], TrialScore]) -> str:
    tasks, seeds = sorted({task for task, _ in trials}), sorted({seed for _, seed in trials})
    more = ", ..." if len(seeds) > 8 else ""
    return f"{', '.join(tasks)} with seeds {', '.join(map(str, seeds[:8]))}{more}"


def _without_partner(
    trials: Mapping[tuple[str, int], TrialScore], others: Mapping[tuple[str, int], TrialScore], other: RunScores
) -> dict[str, str]:
    failed = {(s.task_id, s.seed) for s in other.scores if not s.is_judged}
    found: dict[str, str] = {}
    for key in sorted(trials.keys() - others.keys()):
        trial_id = trials[key].trial_id
        why = "recording skipped" if f"{trial_id}.h5" in other.skipped else "not in the run"
        found[trial_id] = "harness failed" if key in failed else why
    return found


def _info(run: RunScores) -> RunInfo:
    with_verdict = judged(run.scores)
    return RunInfo(
        policy=with_verdict[0].policy_title,
        language_backend=tuple(sorted({s.language_backend for s in with_verdict})),
        n_trials=len(with_verdict),
        n_harness_errors=len(run.scores) - len(with_verdict),
        n_planned=len(with_verdict) + len(run.unjudged),
        skipped=run.skipped,
        n_missing=len(run.missing),
        versions=run.versions,
    )
