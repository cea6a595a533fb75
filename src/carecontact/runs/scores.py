"""Score a folder of recordings and write the result."""

from __future__ import annotations

import gzip
import json
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from carecontact.errors import ConfigError
from carecontact.recording.writer import replace_file
from carecontact.runs.aggregate import (
    additional_medians,
    exceedances,
    gamma_sweep,
    gate_sweep,
    quadrants,
    rate,
    valid_ratio,
)
from carecontact.runs.score_files import score_files
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.result import TrialScore
from carecontact.stats import median

RESULTS_NAME, RESULTS_SCHEMA = "results.json", "carecontact-results-1"
GZIP = b"\x1f\x8b"
"""First bytes of such a file (RFC 1952)."""


@dataclass(frozen=True, kw_only=True)
class RunScores:
    scores: list[TrialScore]
    """In the order of the file names."""
    skipped: dict[str, str] = field(default_factory=dict[str, str])
    """File name -> why it was not scored."""
    versions: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Package -> every version that the scored recordings name; more than one means a mixed run."""
    missing: tuple[str, ...] = ()
    """Trials that were planned and have no score; where no plan is known, none."""


def score_run(folder: Path | str, *, jobs: int = 1) -> RunScores:
    """Score every ``*.h5`` of a run's folder; writes nothing. The result does not depend on ``jobs``.

    A file that cannot be read or scored, or that is not named after its trial, is skipped with the reason; so is one
    that ends in ``.H5``.
    Raises ConfigError if the folder does not exist or the trials are of more than one protocol, policy or world;
    RecordingError if a process that scored died.

    Args:
        jobs: processes; more than one are started afresh, so that a script needs its ``__main__`` guarded and metrics
            of another package have to come by its entry points.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"run folder {folder} does not exist")
    scores: list[TrialScore] = []
    skipped = {path.name: f"{path}: not looked into: a recording's name ends in .h5" for path in misnamed(folder)}
    versions: dict[str, set[str]] = {}
    paths = sorted(folder.glob("*.h5"))
    for path, found in zip(paths, score_files(paths, jobs=jobs), strict=True):
        if isinstance(found, str):
            skipped[path.name] = found
            continue
        scores.append(found.score)
        for package, version in found.versions.items():
            versions.setdefault(package, set()).add(version)
    check_one_run(scores)
    return RunScores(scores=scores, skipped=skipped, versions={k: sorted(v) for k, v in sorted(versions.items())})


def misnamed(folder: Path) -> list[Path]:
    """Files that end as a recording does but for the case, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix != ".h5" and path.suffix.lower() == ".h5")


def check_one_run(scores: Sequence[TrialScore]) -> None:
    """Raises ConfigError if the scores are of several protocols, policies or worlds: their rates must not be pooled."""
    protocols, policies = set[str](), set[str]()
    for score in scores:
        protocols.add(f"{score.protocol_title} ({score.protocol_sha256[:12]})")
        policies.add(score.policy)
    for what, found in (("protocols", protocols), ("policies", policies)):
        if len(found) > 1:
            raise ConfigError(f"trials of {len(found)} {what} must not be pooled: {', '.join(sorted(found))}")
    _check_one_world(judged(scores))


def _check_one_world(scores: Sequence[TrialScore]) -> None:
    found = world_difference(scores)
    if found is not None:
        what, first, other = found
        raise ConfigError(
            f"{first.trial_id}.h5 and {other.trial_id}.h5 are of different worlds and must not be pooled: "
            f"{what} {first.world[what][:12]} and {other.world[what][:12]}"
        )


def world_difference(scores: Sequence[TrialScore]) -> tuple[str, TrialScore, TrialScore] | None:
    """The first part of the world in which two scores differ, and the two; None in one world.

    The compiled model has the fine mesh on the task's region, so that models are compared region by region.
    """
    first: dict[tuple[str, ...], TrialScore] = {}
    for score in scores:
        for what, value in score.world.items():
            place = (what, score.region) if what == "model" else (what,)
            other = first.setdefault(place, score)
            if other.world[what] != value:
                return what, other, score
    return None


def judged(scores: Iterable[TrialScore]) -> list[TrialScore]:
    """The trials that say something about the policy: all but those in which the harness failed."""
    return [s for s in scores if s.is_judged]


def harness_errors(scores: Iterable[TrialScore]) -> list[dict[str, str]]:
    """``trial_id`` and ``message`` of the trials in which the harness failed."""
    return [
        {"trial_id": s.trial_id, "message": s.failure_message or "no reason recorded"}
        for s in scores
        if not s.is_judged
    ]


def joined(a: RunScores, b: RunScores) -> RunScores:
    """One run whose trials were scored in two parts, on two machines for example; in the order of their ids.

    Raises ConfigError for parts that have a trial in common, or are of different protocols, policies, language
    backends, definitions or worlds.
    """
    common = sorted({s.trial_id for s in a.scores} & {s.trial_id for s in b.scores})
    if common:
        raise ConfigError(f"{len(common)} trial(s) are in both, {common[0]} the first")
    for what, of in (("language backends", "language_backend"), ("definitions", "metric_versions")):
        found = [{str(getattr(s, of)) for s in judged(part.scores)} for part in (a, b)]
        if all(found) and found[0] != found[1]:
            raise ConfigError(f"different {what}, {' and '.join(', '.join(sorted(values)) for values in found)}")
    scores = sorted([*a.scores, *b.scores], key=lambda score: score.trial_id)
    check_one_run(scores)
    scored = {score.trial_id for score in scores}
    names = a.versions.keys() | b.versions.keys()
    return RunScores(
        scores=scores,
        skipped=a.skipped | b.skipped,
        versions={n: sorted({*a.versions.get(n, []), *b.versions.get(n, [])}) for n in sorted(names)},
        missing=tuple(trial for trial in sorted({*a.missing, *b.missing}) if trial not in scored),
    )


def write_scores(folder: Path | str, run: RunScores) -> Path:
    """Write ``results.json`` into ``folder`` at once; the same scores give the same bytes. Returns its path."""
    return write_results(folder, results(run))


def write_results(folder: Path | str, data: Mapping[str, Any]) -> Path:
    """Write the content of a ``results.json``; the same content gives the same bytes. Returns its path."""
    path = Path(folder) / RESULTS_NAME
    replace_file(path, _results_bytes(data))
    return path


def _results_bytes(data: Mapping[str, Any]) -> bytes:
    return (json.dumps(data, sort_keys=True, indent=1, allow_nan=False) + "\n").encode("ascii")


def pack_results(path: Path, run: RunScores) -> None:
    """Write the content of a ``results.json`` packed with gzip, a tenth of its size; ``read_results`` reads both.

    A file that already holds it stays: other releases of zlib pack into other bytes.
    """
    content = _results_bytes(results(run))
    with suppress(ConfigError, FileNotFoundError):
        if _unpacked(path) == content:
            return
    replace_file(path, gzip.compress(content, mtime=0))


def read_results(path: Path | str) -> RunScores:
    """The scores in a ``results.json``, packed with gzip or not, as they were written; nothing is recomputed.

    Raises ConfigError for a file that cannot be read, contradicts itself or mixes protocols, policies or worlds.
    """
    try:
        stored = _Results.model_validate_json(_unpacked(Path(path)))
    except ValidationError as error:
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc'])) or 'content'}: {first['msg']}"
        raise ConfigError(f"{path} is damaged or of another release ({why})") from error
    twice = [trial_id for trial_id, k in Counter(s.trial_id for s in stored.trials).items() if k > 1]
    if twice:
        raise ConfigError(f"{path} is damaged: {twice[0]} is in it twice")
    for score in stored.trials:
        if why := contradiction(score):
            raise ConfigError(f"{path} is damaged or changed by hand: {score.trial_id}: {why}")
    overlap = sorted({s.trial_id for s in stored.trials} & set(stored.missing))
    if overlap:
        raise ConfigError(f"{path} is damaged: {overlap[0]} is among its trials and among those that are missing")
    check_one_run(stored.trials)
    return RunScores(
        scores=stored.trials, skipped=stored.skipped, versions=stored.versions, missing=tuple(stored.missing)
    )


def _unpacked(path: Path) -> bytes:
    content = path.read_bytes()
    if not content.startswith(GZIP):
        return content
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, zlib.error) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error


class _Results(BaseModel):
    """What of ``results.json`` is not computed from its trials."""

    version: Annotated[Literal["carecontact-results-1"], Field(alias="schema")]
    trials: list[TrialScore]
    skipped: dict[str, str]
    versions: dict[str, list[str]]
    missing: list[str] = []


AT_LEAST_ZERO = (
    "duration_s", "c1_peak_force_n", "c1_peak_filtered_n", "c1_peak_contact_sum_n", "c1_peak_any_segment_n",
    "c4_motion_activity", "c5_force_sd_n", "contact_s", "longest_on_s", "stroke_m", "extent_m", "reversals",
    "wrist_displacement_m", "wrist_displacement_any_m", "indentation_m", "impulse_ns",
)  # fmt: skip


def contradiction(score: TrialScore) -> str | None:
    """What no scorer can have written of a trial; None where there is nothing."""
    if score.trial_id != f"{score.task_id}-s{score.seed:03d}":
        return f"it says task {score.task_id}, seed {score.seed}"
    if score.safety_gated and not score.region_correct:
        return "safety-gated, but not region-correct"
    if score.region_correct and not score.c3_success:
        return "region-correct, but no success"
    if score.c3_success and not score.valid_contact:
        return "a success without valid contact"
    if score.region_correct == (score.failure_mode is not None) and score.is_judged:
        return f"region-correct is {score.region_correct} and its failure mode {score.failure_mode}"
    for name in AT_LEAST_ZERO:
        value = getattr(score, name)
        if value is not None and not 0 <= value < inf:
            return f"{name} is {value}; valid: 0 and above"
    if score.valid_contact == (score.c1_peak_force_n is None):
        return f"valid contact is {score.valid_contact} and its peak force {score.c1_peak_force_n} N"
    highest = max(score.peak_force_n.values(), default=0.0)
    if (score.c1_peak_force_n or 0.0) > highest:
        return f"peak force {score.c1_peak_force_n:g} N, but no touched segment above {highest:g} N"
    over = [s for s, peak in score.peak_force_n.items() if s in score.over_limit or peak > score.f_pain_n.get(s, inf)]
    if score.safety_gated and over:
        return f"safety-gated, but the {over[0]} above its limit, at {score.peak_force_n[over[0]]:g} N"
    if score.c4_motion_activity is not None and score.c4_motion_activity > 1:
        return f"c4_motion_activity is {score.c4_motion_activity}; valid: 0 to 1"
    return None


def results(run: RunScores) -> dict[str, Any]:
    """The content of ``results.json``: the field's evaluation JSON (``overall``, ``per_task`` with ``n_episodes``,
    ``n_success`` and ``pc_success``) and what this benchmark adds. Rates are in percent where the key says ``pc``."""
    scores = run.scores
    check_one_run(scores)
    backends = {s.language_backend for s in judged(scores)}
    first = scores[0] if scores else None
    tasks = sorted({s.task_id for s in scores})
    regions = sorted({s.region for s in scores})
    return {
        "schema": RESULTS_SCHEMA,
        "policy": first.policy if first else None,
        "language_backend": sorted(backends),
        "protocol": {"id": first.protocol_id, "sha256": first.protocol_sha256, "overrides": first.overrides}
        if first
        else None,
        "metric_versions": first.metric_versions if first else {},
        "versions": run.versions,
        "skipped": run.skipped,
        "missing": list(run.missing),
        "harness_errors": harness_errors(scores),
        "overall": summarise(scores),
        "per_task": {task: summarise([s for s in scores if s.task_id == task]) for task in tasks},
        "per_region": {region: summarise([s for s in scores if s.region == region]) for region in regions},
        "sweeps": {"gamma": gamma_sweep(judged(scores)), **gate_sweep(judged(scores))},
        "limit_packs": {
            name: {"title": pack.title, "source": pack.source, "status": pack.status}
            for name, pack in LIMIT_PACKS.items()
        },
        "trials": [s.model_dump(mode="json") for s in scores],
    }


def summarise(scores: Iterable[TrialScore]) -> dict[str, Any]:
    """Rates, medians and counts over those trials that are ``judged``; C2 is pooled over Push alone."""
    scores = judged(scores)
    n = len(scores)
    success = rate(sum(s.c3_success for s in scores), n)
    return {
        "n_episodes": n,
        "n_success": success["n"],
        "pc_success": success["pc"],
        "pc_success_ci95": success["pc_ci95"],
        "region_correct": rate(sum(s.region_correct for s in scores), n),
        "safety_gated": rate(sum(s.safety_gated for s in scores), n),
        "valid_contact": rate(sum(s.valid_contact for s in scores), n),
        "valid_ratio": valid_ratio(scores),
        "exceedances": exceedances(scores),
        "quadrants": quadrants(scores),
        "medians": {
            "c1_peak_force_n": asdict(median(s.c1_peak_force_n for s in scores)),
            "c2_joint_margin_rad_push": asdict(median(s.c2_joint_margin_rad for s in scores if s.action == "push")),
            "c4_motion_activity": asdict(median(s.c4_motion_activity for s in scores)),
            "c5_force_sd_n": asdict(median(s.c5_force_sd_n for s in scores)),
        },
        "additional": additional_medians(scores),
        "anatomy": dict(Counter(s.anatomy for s in scores)),
        "failure_modes": dict(Counter(s.failure_mode for s in scores if s.failure_mode)),
        "attributions": dict(Counter(s.attribution for s in scores if s.attribution)),
    }
