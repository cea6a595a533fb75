"""What ``results.json`` says of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from carecontact.runs.aggregate import (
    additional_medians,
    exceedances,
    gamma_sweep,
    gate_sweep,
    quadrants,
    rate,
    valid_ratio,
)
from carecontact.runs.pooling import check_one_run, harness_errors, judged, task_of
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.metrics.metric import METRICS, Metric
from carecontact.scoring.result import TrialScore
from carecontact.stats import median

RESULTS_SCHEMA = "carecontact-results-1"


def results(run: RunScores) -> dict[str, Any]:
    """Return the content of ``results.json``: the field's evaluation JSON (``overall``, ``per_task`` with
    ``n_episodes``, ``n_success`` and ``pc_success``) and what this benchmark adds. Rates are in percent where the key
    says ``pc``."""
    scores = run.scores
    check_one_run(scores)
    backends = {s.language_backend for s in judged(scores)}
    first = scores[0] if scores else None
    tasks = sorted({s.task_id for s in scores})
    regions = {s.task_id: s.region for s in scores}
    # A task of which nothing is scored has no region here; its trials lack in the overall counts all the same.
    unknown = {trial: regions.get(task_of(trial)) for trial in run.unjudged}
    return {
        "schema": RESULTS_SCHEMA,
        "policy": first.policy if first else None,
        "policy_arguments": first.policy_arguments if first else {},
        "language_backend": sorted(backends),
        "protocol": {"id": first.protocol_id, "sha256": first.protocol_sha256, "overrides": first.overrides}
        if first
        else None,
        "rejected_tissue": first.world.get("rejected_tissue") if first else None,
        "metric_versions": first.metric_versions if first else {},
        "versions": run.versions,
        "skipped": run.skipped,
        "missing": list(run.missing),
        "elsewhere": list(run.elsewhere),
        "harness_errors": harness_errors(scores),
        "unjudged": run.unjudged,
        "overall": summarise(scores, unknown=len(unknown)),
        "per_task": {
            task: summarise(
                [s for s in scores if s.task_id == task], unknown=sum(task_of(trial) == task for trial in unknown)
            )
            for task in tasks
        },
        "per_region": {
            region: summarise(
                [s for s in scores if s.region == region], unknown=sum(of == region for of in unknown.values())
            )
            for region in sorted(set(regions.values()))
        },
        "sweeps": {"gamma": gamma_sweep(judged(scores), unknown=len(unknown)), **gate_sweep(judged(scores))},
        "limit_packs": {
            name: {"title": pack.title, "source": pack.source, "status": pack.status, "unit": pack.unit}
            for name, pack in LIMIT_PACKS.items()
        },
        "trials": [s.model_dump(mode="json") for s in scores],
    }


def summarise(scores: Iterable[TrialScore], *, unknown: int = 0) -> dict[str, Any]:
    """Rates, medians and counts over those trials that are ``judged``; a metric pools the trials that it names.

    ``unknown``: planned trials without a verdict, which leave every rate an interval.
    """
    scores = judged(scores)
    n = len(scores)
    success = rate(sum(s.c3_success for s in scores), n, unknown=unknown)
    return {
        "n_planned": n + unknown,
        "n_episodes": n,
        "n_success": success["n"],
        "pc_success": success["pc"],
        "pc_success_between": success["pc_between"],
        "pc_success_ci95": success["pc_ci95"],
        "region_correct": rate(sum(s.region_correct for s in scores), n, unknown=unknown),
        "safety_gated": rate(sum(s.safety_gated for s in scores), n, unknown=unknown),
        "valid_contact": rate(sum(s.valid_contact for s in scores), n, unknown=unknown),
        "valid_ratio": valid_ratio(scores, unknown=unknown),
        "exceedances": exceedances(scores, unknown=unknown),
        "quadrants": quadrants(scores),
        "medians": {
            _median_key(row): asdict(median(row.pooled(scores)))
            for row in METRICS.values()
            if row.field is not None and row.median
        },
        "additional": additional_medians(scores),
        "anatomy": dict(Counter(s.anatomy for s in scores)),
        "failure_modes": dict(Counter(s.failure_mode for s in scores if s.failure_mode)),
        "attributions": dict(Counter(s.attribution for s in scores if s.attribution)),
    }


def _median_key(metric: Metric) -> str:
    """Return the metric's field, and what it is pooled over. Push stands for all actions that move the person: the key
    is part of the format, which does not change where another package adds such an action."""
    pool = ("push",) if metric.pool == "moving" else metric.pool or ()
    return "_".join((metric.field or metric.id, *pool))
