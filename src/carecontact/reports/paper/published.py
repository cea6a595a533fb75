"""The values that the paper prints, read from ``published.toml``."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from carecontact.reports.compare.outcomes import RATES, Outcome, score_outcomes


@dataclass(frozen=True, kw_only=True)
class PaperMethod:
    policy: str
    """This package's name of the method; ``pi05`` is in no registry."""
    title: str
    rates: dict[str, tuple[float, float, float]]
    """``success``, ``region_correct``, ``safety_gated`` -> fraction and its 95 % interval"""
    medians: dict[str, float]
    """C1 [N], C2 [rad], C4, C5 [N]"""
    anatomy: dict[str, dict[str, int]]
    """Region -> trials ``n``, with ``target``, ``off_target`` or ``none`` as contact, and ``success``"""
    failed: int
    dominant: tuple[str, int] | None
    """The failure mode that the paper counts, and its count"""

    def value(self, outcome: Outcome) -> float:
        """Return a rate as a fraction, or a median in the outcome's unit."""
        return self.rates[outcome.id][0] if outcome.is_rate else self.medians[outcome.id]


@dataclass(frozen=True, kw_only=True)
class Paper:
    runs_per_method: int
    methods: dict[str, PaperMethod]
    pvalues: dict[str, tuple[str, float]]
    """Outcome -> test and p of state-machine against voxposer, for those that were tested"""
    capability: dict[str, list[str]]
    """System -> yes, partly or no for each of five capabilities"""
    tasks: dict[str, list[str]]
    """Task -> its name and what it is meant to show"""
    metrics: dict[str, list[str]]
    """Metric -> its layer and name"""
    protocol: dict[str, str]
    """What is frozen -> how"""

    def scores(self) -> list[Outcome]:
        """Return the outcomes of which the paper prints medians."""
        printed = next(iter(self.methods.values())).medians
        return [outcome for outcome in score_outcomes() if outcome.id in printed]


def read_paper() -> Paper:
    content = tomllib.loads(Path(__file__).with_name("published.toml").read_text("utf-8"))
    failures = {row["policy"]: row for row in content["failures"]}
    return Paper(
        runs_per_method=content["runs_per_method"],
        methods={row["policy"]: _method(row, failures[row["policy"]], content) for row in content["method"]},
        pvalues={row["outcome"]: (row["test"], row["pvalue"]) for row in content["contrast"]},
        **{name: content[name] for name in ("capability", "tasks", "metrics", "protocol")},
    )


def _method(row: dict, failures: dict, content: dict) -> PaperMethod:
    policy = row["policy"]
    return PaperMethod(
        policy=policy,
        title=row["title"],
        rates={rate.id: (row[rate.id]["pc"] / 100, *(v / 100 for v in row[rate.id]["ci95"])) for rate in RATES},
        medians=row["medians"],
        anatomy={a["region"]: a["counts"] for a in content["anatomy"] if a["policy"] == policy},
        failed=failures["failed"],
        dominant=(failures["dominant"], failures["dominant_count"]) if "dominant" in failures else None,
    )
