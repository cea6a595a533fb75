"""Which runs may be compared, and which of their trials belong together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.reports.text import listed
from carecontact.runs.pooling import EFFECT, PROVENANCE, check_one_run, judged, machines, world_difference, world_part
from carecontact.runs.results_file import RESULTS_NAME
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore


def check_different(places: Sequence[Path]) -> None:
    """Raises ConfigError for a run that is named twice, also once by its folder and once by the results in it."""
    folders = [path.resolve().parent if path.name == RESULTS_NAME else path.resolve() for path in places]
    twice = next((path for path, folder in zip(places, folders, strict=True) if folders.count(folder) > 1), None)
    if twice is not None:
        raise ConfigError(f"{twice} is given twice; name different runs")


def check_complete(runs: Mapping[str, RunScores], *, otherwise: str = "") -> None:
    """Raises ConfigError for a run with planned trials that have no verdict: its rates would be over fewer.

    Args:
        runs: name for messages -> run.
        otherwise: what else the caller offers than to complete the run.
    """
    for name, run in runs.items():
        if run.incomplete:
            first, why = next(iter(run.unjudged.items()))
            reason = why.partition("\n")[0]
            raise ConfigError(
                f"{name} is {run.incomplete} (the first without: {first}, {reason}); {run.completing}{otherwise}"
            )


def check_comparable(runs: Mapping[str, Sequence[TrialScore]]) -> None:
    """Raises ConfigError, naming the runs and what differs, unless all ran one protocol, same overrides, in one world,
    were scored by the same definitions, and have a trial that says something about the policy.

    Args:
        runs: name for messages -> scores.
    """
    for name, scores in runs.items():
        check_one_run(scores)
        if not judged(scores):
            raise ConfigError(
                f"run {name} has no trial to compare: none is scored, or the harness failed in all of them; "
                "give its `carecontact run` command again"
            )
    (reference, scores), *others = runs.items()
    for name, other in others:
        _check_two(reference, scores, name, other)


def _check_two(name_a: str, a: Sequence[TrialScore], name_b: str, b: Sequence[TrialScore]) -> None:
    first, other = a[0], b[0]
    if first.protocol_sha256 != other.protocol_sha256 or first.overrides != other.overrides:
        told = [f"{s.protocol_title} ({s.protocol_sha256[:12]})" for s in (first, other)]
        raise ConfigError(
            f"{name_a} ran {told[0]}, {name_b} ran {told[1]}: "
            "only runs of the same protocol with the same overrides can be compared"
        )
    if first.metric_versions != other.metric_versions:
        keys = sorted(
            key
            for key in first.metric_versions.keys() | other.metric_versions.keys()
            if first.metric_versions.get(key) != other.metric_versions.get(key)
        )
        told = ", ".join(f"{k} {first.metric_versions.get(k)} and {other.metric_versions.get(k)}" for k in keys)
        raise ConfigError(
            f"{name_a} and {name_b} are scored by different definitions ({told}): score both again with one release"
        )
    found = world_difference([*judged(a), *judged(b)])
    if found is not None:
        what, one, two = found
        parts = [f"{world_part(s, what)} ({s.trial_id} of {name})" for s, name in ((one, name_a), (two, name_b))]
        told = f"{what} {' and '.join(parts)}"
        if what == "salt":
            raise ConfigError(
                f"{name_a} and {name_b} were run on different persons: {told}; run both with the same --salt-file, or "
                "both without"
            )
        raise ConfigError(
            f"{name_a} and {name_b} were simulated in different worlds: {told}; run both with the same release, body, "
            "robot and controller"
        )


def machines_text(runs: Mapping[str, Sequence[TrialScore]]) -> str:
    """Return a sentence about what computed and drew comparable runs, where it differs; else empty.

    Args:
        runs: name for messages -> scores.
    """
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
