"""One method of the study: its rates, medians and failures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carecontact.contract.protocol import Protocol
from carecontact.reports.compare.outcomes import RATES
from carecontact.reports.failures import AnatomyRow, Cause, anatomy, causes, failure_modes
from carecontact.reports.table import SummaryRow, summary_rows
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores
from carecontact.stats import Proportion, wilson_interval


@dataclass(frozen=True, kw_only=True)
class RunHead:
    policy: str
    title: str
    """Of the protocol with its overrides"""
    language_backend: tuple[str, ...]
    n: int
    """Trials that say something about the policy"""
    n_planned: int
    """Tasks times seeds of the protocol"""
    n_harness_errors: int
    skipped: dict[str, str]
    versions: dict[str, list[str]]


@dataclass(frozen=True, kw_only=True)
class Method:
    head: RunHead
    rates: dict[str, Proportion]
    summary: tuple[SummaryRow, ...]
    """One row a task, then all"""
    modes: tuple[dict[str, Any], ...]
    causes: tuple[Cause, ...]
    anatomy: tuple[AnatomyRow, ...]


def head_of(run: RunScores, protocol: Protocol) -> RunHead:
    counted = judged(run.scores)
    return RunHead(
        policy=counted[0].policy,
        title=counted[0].protocol_title,
        language_backend=tuple(sorted({s.language_backend for s in counted})),
        n=len(counted),
        n_planned=len(protocol.tasks) * len(protocol.randomization.seeds),
        n_harness_errors=len(run.scores) - len(counted),
        skipped=run.skipped,
        versions=run.versions,
    )


def method_of(run: RunScores, protocol: Protocol) -> Method:
    counted = judged(run.scores)
    return Method(
        head=head_of(run, protocol),
        rates={r.id: wilson_interval(sum(bool(getattr(s, r.field)) for s in counted), len(counted)) for r in RATES},
        summary=tuple(summary_rows(run.scores)),
        modes=tuple(failure_modes(run.scores)),
        causes=tuple(causes(run.scores)),
        anatomy=tuple(anatomy(run.scores)),
    )
