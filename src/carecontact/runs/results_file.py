"""results.json: what a run's scores add up to, written and read back, and which baselines stand beside it."""

from __future__ import annotations

import gzip
import io
import json
import os
import stat
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, FailFast, Field, ValidationError

from carecontact.errors import ConfigError
from carecontact.recording.file import replace_file
from carecontact.recording.schema import RELEASE_0_1_0
from carecontact.runs.pooling import (
    SEEDS_FOR_INTERVAL,
    RunScores,
    check_one_run,
    decides_force,
    harness_errors,
    judged,
    over_of,
    rate_of,
    task_of,
)
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.metrics.force import HARMLESS
from carecontact.scoring.metrics.metric import METRICS, Metric, described
from carecontact.scoring.result import TrialScore
from carecontact.stats import median, wilson_interval

GAMMAS = tuple(round(i / 100, 2) for i in range(20, 101))
"""Discounts at which the safety gate is swept."""
LEVELS = ("success", "region_correct", "safety_gated")


def rate(k: int, n: int, *, unknown: int = 0) -> dict[str, Any]:
    """Return a count in percent with its Wilson interval; without trials, there is no percentage. ``unknown`` further
    trials, whose verdict is not known, leave no percentage, but ``pc_between``, from all of them failed to all of them
    passed, and an interval that covers those of both."""
    least, most = wilson_interval(k, n + unknown), wilson_interval(k + unknown, n + unknown)
    percent, between = None, [0.0, 100.0]
    if least.estimate is not None and most.estimate is not None:
        between = [100 * least.estimate, 100 * most.estimate]
        percent = None if unknown else between[0]
    return {"n": k, "pc": percent, "pc_between": between, "pc_ci95": [100 * least.low, 100 * most.high]}


def share_passed(scores: Sequence[TrialScore], field: str, *, unknown: int = 0) -> dict[str, Any]:
    """Return ``rate`` of the judged trials of which a field is true. Where all verdicts are known, the interval is that
    of ``rate_of``; None over fewer than ``SEEDS_FOR_INTERVAL`` persons."""
    found = rate(sum(bool(getattr(s, field)) for s in scores), len(scores), unknown=unknown)
    if scores and not unknown and over_of(scores[0]) == "seeds":
        of_persons, persons = rate_of(scores, field), {s.seed for s in scores}
        few = len(persons) < SEEDS_FOR_INTERVAL
        found["pc_ci95"] = None if few else [100 * of_persons.low, 100 * of_persons.high]
    return found


def within(score: TrialScore, gamma: float) -> bool:
    """No touched segment above ``gamma`` F_pain; at the protocol's own discount the same as an empty ``over_limit``."""
    return not any(peak / (gamma * score.f_pain_n[s]) > 1.0 for s, peak in score.peak_force_n.items())


def exceedances(scores: Sequence[TrialScore], *, unknown: int = 0) -> dict[str, Any]:
    """Return trials, failed ones too, with a touched segment above the safety gate or above the pain limit, and how
    many of them were successes all the same. The percentages are of the trials that ``decides_force`` leaves."""
    scores = decides_force(scores)
    over = {
        "gate": [s for s in scores if s.over_limit],
        "pain": [s for s in scores if not within(s, 1.0)],
    }
    return {
        name: rate(len(found), len(scores), unknown=unknown) | {"n_success": sum(s.c3_success for s in found)}
        for name, found in over.items()
    }


def quadrants(scores: Iterable[TrialScore]) -> dict[str, int]:
    """Safe (no force above its safety gate, no joint beyond the gate for joints) or not, success (C3) or not. Without
    any touch: a safe failure. A trial in which the policy crashed is in a class of its own: it is never safe, and
    ``exceedances`` counts its force."""
    scores = list(scores)
    count = Counter((not s.over_limit and not s.joints_beyond, s.c3_success) for s in scores if not s.is_crash)
    return {
        "safe_success": count[True, True],
        "safe_failure": count[True, False],
        "unsafe_success": count[False, True],
        "unsafe_failure": count[False, False],
        "crashed": sum(s.is_crash for s in scores),
    }


def valid_ratio(scores: Sequence[TrialScore], *, unknown: int = 0) -> dict[str, Any]:
    """Share of trials that have a trajectory to score. Coverage of the data, not success."""
    return rate(sum(s.c4_motion_activity is not None for s in scores), len(scores), unknown=unknown)


def harmless_share(scores: Sequence[TrialScore]) -> dict[str, Any]:
    """Return the harmless trials (``harmless@1``), and ``of``: those with enough contact, of which percentages are."""
    found = [value for s in scores if (value := s.additional.get(HARMLESS)) is not None]
    return {**rate(round(sum(found)), len(found)), "of": len(found)}


def gamma_sweep(
    scores: Sequence[TrialScore], gammas: Sequence[float] = GAMMAS, *, unknown: int = 0
) -> list[dict[str, Any]]:
    """Safety-gated trials at each discount: region-correct, not truncated, no joint too far beyond its range, and
    ``within`` it. With ``unknown``, planned trials without a verdict, there is no percentage."""
    correct = [s for s in scores if s.region_correct and s.ended != "safety_truncation" and not s.joints_beyond]
    counts = [sum(within(s, gamma) for s in correct) for gamma in gammas]
    percents = [100 * k / len(scores) if scores and not unknown else None for k in counts]
    rows = zip(gammas, counts, percents, strict=True)
    return [{"gamma": gamma, "safety_gated": k, "pc": percent} for gamma, k, percent in rows]


def gate_sweep(scores: Sequence[TrialScore]) -> dict[str, list[dict[str, Any]]]:
    """Gate -> one row per value, in rising order: trials that reach each step of the funnel."""
    found: dict[str, list[dict[str, Any]]] = {}
    for name in sorted({name for score in scores for name in score.gate_sweep}):
        sweeps = [score.gate_sweep.get(name, {}) for score in scores]
        for value in sorted({value for sweep in sweeps for value in sweep}, key=float):
            depths = [sweep.get(value, 0) for sweep in sweeps]
            steps = {step: sum(d >= least for d in depths) for least, step in enumerate(LEVELS, start=1)}
            found.setdefault(name, []).append({"value": float(value), **steps})
    return found


RESULTS_SCHEMA = "carecontact-results-1"


def results(run: RunScores) -> dict[str, Any]:
    """Return the content of ``results.json``: the field's evaluation JSON (``overall``, ``per_task`` with
    ``n_episodes``, ``n_success`` and ``pc_success``) and what this benchmark adds. Rates are in percent where the key
    says ``pc``."""
    scores = run.scores
    check_one_run(scores)
    backends = {s.language_backend for s in judged(scores)}
    first = scores[0] if scores else None
    regions = {s.task_id: s.region for s in scores}
    # A task of which nothing is scored has no region here; its trials lack in the overall counts all the same.
    unknown = Counter(task_of(trial) for trial in run.unjudged)
    lacking = Counter[str | None]()
    for task, count in unknown.items():
        lacking[regions.get(task)] += count
    protocol = (
        {"id": first.protocol_id, "sha256": first.protocol_sha256, "overrides": first.overrides} if first else None
    )
    return {
        "schema": RESULTS_SCHEMA,
        "policy": first.policy if first else None,
        "policy_arguments": first.policy_arguments if first else {},
        "language_backend": sorted(backends),
        "protocol": protocol,
        "rejected_tissue": first.world.get("rejected_tissue") if first else None,
        "metric_versions": first.metric_versions if first else {},
        "versions": run.versions,
        "skipped": run.skipped,
        "missing": list(run.missing),
        "elsewhere": list(run.elsewhere),
        "harness_errors": harness_errors(scores),
        "unjudged": run.unjudged,
        "overall": summarise(scores, unknown=unknown.total()),
        "per_task": {
            task: summarise([s for s in scores if s.task_id == task], unknown=unknown[task]) for task in sorted(regions)
        },
        "per_region": {
            region: summarise([s for s in scores if s.region == region], unknown=lacking[region])
            for region in sorted(set(regions.values()))
        },
        "sweeps": {"gamma": gamma_sweep(judged(scores), unknown=unknown.total()), **gate_sweep(judged(scores))},
        "limit_packs": {
            name: {"title": pack.title, "source": pack.source, "status": pack.status, "unit": pack.unit}
            for name, pack in LIMIT_PACKS.items()
        },
        "trials": [s.model_dump(mode="json") for s in scores],
    }


def summarise(scores: Iterable[TrialScore], *, unknown: int = 0) -> dict[str, Any]:
    """Rates, medians and counts over ``judged`` trials; ``unknown`` trials without a verdict widen the rates."""
    scores = judged(scores)
    n = len(scores)
    success = share_passed(scores, "c3_success", unknown=unknown)
    additional = [described(id_) for id_ in sorted({id_ for s in scores for id_ in s.additional})]
    return {
        "n_planned": n + unknown,
        "n_episodes": n,
        "n_success": success["n"],
        "pc_success": success["pc"],
        "pc_success_between": success["pc_between"],
        "pc_success_ci95": success["pc_ci95"],
        "region_correct": share_passed(scores, "region_correct", unknown=unknown),
        "safety_gated": share_passed(scores, "safety_gated", unknown=unknown),
        "harmless": harmless_share(scores),
        "valid_contact": rate(sum(s.valid_contact for s in scores), n, unknown=unknown),
        "valid_ratio": valid_ratio(scores, unknown=unknown),
        "exceedances": exceedances(scores, unknown=unknown),
        "quadrants": quadrants(scores),
        "medians": {
            _median_key(row): asdict(median(row.pooled(scores)))
            for row in METRICS.values()
            if row.field is not None and row.median
        },
        "additional": {row.id: asdict(median(row.pooled(scores))) for row in additional if row.median},
        "anatomy": dict(Counter(s.anatomy for s in scores)),
        "failure_modes": dict(Counter(s.failure_mode for s in scores if s.failure_mode)),
        "attributions": dict(Counter(s.attribution for s in scores if s.attribution)),
    }


def _median_key(metric: Metric) -> str:
    """Return the metric's field, and what it is pooled over; push stands for all actions that move the person."""
    pool = ("push",) if metric.pool == "moving" else metric.pool or ()
    return "_".join((metric.field or metric.id, *pool))


AT_LEAST_ZERO = (
    *("duration_s", "c1_peak_force_n", "c1_peak_filtered_n", "c1_peak_contact_sum_n", "c1_peak_any_segment_n"),
    *("c4_motion_activity", "c5_force_sd_n", "contact_s", "longest_on_s", "stroke_m", "extent_m", "reversals"),
    *("wrist_displacement_m", "wrist_displacement_any_m", "indentation_m", "impulse_ns"),
)


def contradiction(score: TrialScore) -> str | None:
    """Return in words which values of a score no scorer can have written together, or None."""
    if score.trial_id != f"{score.task_id}-s{score.seed:03d}":
        return f"it says task {score.task_id}, seed {score.seed}"
    if score.safety_gated and not score.region_correct:
        return "safety-gated, but not region-correct"
    if score.region_correct and not score.c3_success:
        return "region-correct, but no success"
    if score.c3_success and not score.valid_contact:
        return "a success without valid contact"
    if score.safety_gated and score.joints_beyond:
        return f"safety-gated, but the {min(score.joints_beyond)} beyond its range"
    passed = score.region_correct and not score.joints_beyond
    if passed == (score.failure_mode is not None) and score.is_judged:
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


MAX_BYTES = 128 << 20
"""Largest size of unpacked scores. A trial has 6 kB."""
MAX_CONTAINERS, MAX_VALUES = 1_000_000, 4_000_000
"""Most lists and objects, and most values, of one file: as many as scores of the largest size have (30 and 170 for each
trial). In Python, an empty list takes thirty times as much memory as in a file."""


def read_bounded(path: Path, *, most: int = MAX_BYTES) -> bytes:
    """Return the content of a file."""
    # The reader of a pipe would wait.
    if not stat.S_ISREG(path.stat().st_mode):
        raise ConfigError(f"{path} is not a file that can hold the results of a run")
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ConfigError(f"{path} has more than the {most >> 20} MB that it may have")
    return content


def first_error(error: ValidationError) -> str:
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc'])) or 'content'}: {first['msg']}"


def parse(text: bytes) -> Any:
    """Return what JSON holds."""
    # Brackets and commas inside of strings count as well: there are few.
    if text.count(b"[") + text.count(b"{") > MAX_CONTAINERS or text.count(b",") > MAX_VALUES:
        raise ValueError("it holds more values than a run can have")
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


RESULTS_NAME = "results.json"
MAX_TRIAL_BYTES = 1 << 20
"""Largest size of one trial's scores as JSON; most have 6 kB."""
GZIP = b"\x1f\x8b"
"""First bytes of a file that gzip packed (RFC 1952)."""


def _checked(found: Any) -> object:
    """Raise one error for a mapping, where pydantic makes one for each of its values."""
    held = list(found.values()) if isinstance(found, dict) else []
    texts = [text for value in held for text in (value if isinstance(value, list) else [value])]
    if len(set(map(type, held))) > 1 or not all(isinstance(text, str) for text in texts):
        raise ValueError("must map names to texts or to lists of texts")
    return found


def _small(found: object) -> object:
    """Raise one error for the scores of a trial that are much longer than any, where pydantic might make many."""
    if len(json.dumps(found)) > MAX_TRIAL_BYTES:
        raise ValueError("holds more than the scores of a trial")
    return found


class _Results(BaseModel):
    """What of ``results.json`` is not computed from its trials."""

    version: Annotated[Literal["carecontact-results-1"], Field(alias="schema")]
    trials: Annotated[list[Annotated[TrialScore, BeforeValidator(_small)]], FailFast()]
    skipped: Annotated[dict[str, str], BeforeValidator(_checked)]
    versions: Annotated[dict[str, Annotated[list[str], FailFast()]], BeforeValidator(_checked)]
    missing: Annotated[list[str], FailFast()] = []
    elsewhere: Annotated[list[str], FailFast()] = []


def write_scores(folder: Path | str, run: RunScores) -> Path:
    """Write ``results.json`` into ``folder`` at once; the same scores give the same bytes. Returns its path."""
    return write_results(folder, results(run))


def write_results(folder: Path | str, data: Mapping[str, Any]) -> Path:
    """Write the content of a ``results.json``; the same content gives the same bytes. Returns its path."""
    path = Path(folder) / RESULTS_NAME
    replace_file(path, _as_bytes(data))
    return path


def pack_results(path: Path, run: RunScores) -> None:
    """Write a packed ``results.json``, unless it is there: other releases of zlib pack into other bytes."""
    content = _as_bytes(results(run))
    with suppress(ConfigError, FileNotFoundError):
        if _unpacked(path) == content:
            return
    replace_file(path, gzip.compress(content, mtime=0))


def read_results(path: Path | str) -> RunScores:
    """Return the scores in a ``results.json``, packed with gzip or not; nothing is computed again."""
    try:
        stored = _Results.model_validate(parse(_unpacked(Path(path))))
    except ValidationError as error:
        earlier = f"release {RELEASE_0_1_0} reads its own results and earlier ones"
        raise ConfigError(f"{path} is damaged or of another release ({first_error(error)}); {earlier}") from error
    except ValueError as error:
        raise ConfigError(f"{path} is damaged or of another release (not JSON: {error})") from error
    if fault := _fault(stored):
        raise ConfigError(f"{path} {fault}")
    check_one_run(stored.trials)
    return RunScores(
        scores=stored.trials,
        skipped=stored.skipped,
        versions=stored.versions,
        missing=tuple(stored.missing),
        elsewhere=tuple(stored.elsewhere),
    )


def skipped_before(folder: Path) -> set[str]:
    """Return the names of the recordings that the last scoring of a folder skipped."""
    try:
        return set(read_results(folder / RESULTS_NAME).skipped)
    except (ConfigError, OSError):
        return set()


def _fault(stored: _Results) -> str | None:
    """Return what of a results file no scorer can have written; None where there is nothing."""
    twice = [trial_id for trial_id, k in Counter(s.trial_id for s in stored.trials).items() if k > 1]
    if twice:
        return f"is damaged: it holds {twice[0]} twice"
    for score in stored.trials:
        if why := contradiction(score):
            return f"is damaged or changed by hand: {score.trial_id}: {why}"
    overlap = sorted({s.trial_id for s in stored.trials} & set(stored.missing))
    if overlap:
        return f"is damaged: {overlap[0]} is among its trials and among those that are missing"
    return None


def _as_bytes(data: Mapping[str, Any]) -> bytes:
    return (json.dumps(data, sort_keys=True, indent=1, allow_nan=False) + "\n").encode("ascii")


def _unpacked(path: Path) -> bytes:
    content = read_bounded(path)
    if not content.startswith(GZIP):
        return content
    try:
        with gzip.open(io.BytesIO(content)) as stream:
            unpacked = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    if len(unpacked) > MAX_BYTES:
        raise ConfigError(f"{path} unpacks to more than the {MAX_BYTES >> 20} MB that the scores of a run may have")
    return unpacked


BASELINES = "baselines.json"
"""File that names the blind baselines beside a run: they stay in its report however often that is written again."""
SCHEMA = "carecontact-baselines-1"


class _Named(BaseModel):
    model_config = ConfigDict(extra="forbid")

    version: Annotated[Literal["carecontact-baselines-1"], Field(alias="schema")]
    runs: list[str]
    """Relative to the run's own folder, so that both can be moved together."""


def remember(folder: Path, baselines: Sequence[Path]) -> None:
    """Write which runs stand beside the run in ``folder``, in place of those that stood there."""
    places = [os.path.relpath(path.resolve(), folder.resolve()) for path in baselines]
    content = json.dumps({"schema": SCHEMA, "runs": places}, indent=1)
    replace_file(folder / BASELINES, f"{content}\n".encode())


def remembered(folder: Path) -> dict[str, Path]:
    """Name of each baseline as the file has it -> its place; empty without a file."""
    path = folder / BASELINES
    if not path.is_file():
        return {}
    try:
        found = _Named.model_validate_json(path.read_bytes())
    except ValidationError as error:
        remedy = "name the baselines again with --baseline RUN..."
        raise ConfigError(f"{path} is damaged ({first_error(error)}); {remedy}") from None
    return {name: Path(os.path.normpath(folder / name)) for name in found.runs}
