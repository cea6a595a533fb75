"""Compares two runs of one protocol trial by trial: what differs, and which differences the runs could not have
shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from carecontact import __version__
from carecontact.errors import ConfigError
from carecontact.reports.compare.comparable import check_comparable, check_complete, machines_text, trials_by_key
from carecontact.reports.compare.paired_lines import Line, paired_lines
from carecontact.reports.compare.plain import plain
from carecontact.reports.compare.verdicts import ALPHA, POWER, conclude
from carecontact.reports.over_seeds import Over, over_of
from carecontact.runs.pooling import judged, rejected_text
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore

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
        content = {
            "schema": COMPARISON_SCHEMA,
            "carecontact": __version__,
            "alpha": ALPHA,
            "power": POWER,
            **asdict(self),
        }
        return {key: plain(value) for key, value in content.items()}


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
    check_comparable({"A": a.scores, "B": b.scores})
    of_a, of_b = trials_by_key(a.scores), trials_by_key(b.scores)
    keys = sorted(of_a.keys() & of_b.keys())
    if not keys:
        raise ConfigError(
            f"A and B have no trial (task and seed) in common: A has {_told(of_a)}; B has {_told(of_b)}; "
            "run the same seeds of a task"
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
        policy=counted[0].policy_title,
        language_backend=tuple(sorted({s.language_backend for s in counted})),
        n_trials=len(counted),
        n_harness_errors=len(run.scores) - len(counted),
        n_planned=len(counted) + len(run.unjudged),
        skipped=run.skipped,
        n_missing=len(run.missing),
        versions=run.versions,
    )
