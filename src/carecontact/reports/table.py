"""The per-task summary of one run, as plain data and as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carecontact.runs.pooling import check_one_run, judged
from carecontact.scoring.result import TrialScore
from carecontact.stats import Median, median

NA = "NA"
NOT_DEFINED = "–"
"""A score that this task does not pool, as against NA: one that no trial had."""
POOLED = "all"
COLUMNS = ("task", "name", "n", "success", "region-correct", "safety-gated", "C1 [N]", "C2 [rad]", "C4", "C5 [N]")


@dataclass(frozen=True, kw_only=True)
class SummaryRow:
    """Counts and medians of one task, or of all trials (``task_id`` is POOLED)."""

    task_id: str
    name: str
    n: int
    success: int
    region_correct: int
    safety_gated: int
    c1_n: Median
    c2_rad: Median
    """Over Push trials only; the joint margin says little where nothing was meant to move."""
    c4: Median
    c5_n: Median

    def cells(self) -> list[str]:
        """Strings under COLUMNS; a median carries its valid n where that is not the row's n."""
        rates = [f"{k}/{self.n}" for k in (self.success, self.region_correct, self.safety_gated)]
        medians = [
            number(self.c1_n.estimate, 2) + self._valid(self.c1_n),
            (angle(self.c2_rad.estimate) + self._valid(self.c2_rad)) if self.c2_rad.n else NOT_DEFINED,
            number(self.c4.estimate, 3) + self._valid(self.c4),
            number(self.c5_n.estimate, 2) + self._valid(self.c5_n),
        ]
        return [self.task_id, self.name, str(self.n), *rates, *medians]

    def _valid(self, m: Median) -> str:
        return "" if m.estimate is None or m.n_valid == self.n else f" (n={m.n_valid})"


def number(value: float | None, digits: int) -> str:
    return NA if value is None else f"{value:.{digits}f}"


def angle(value: float | None) -> str:
    """[rad]; margins at a joint limit are of the order of 1e-4, so small ones are written in powers of ten."""
    if value is None:
        return NA
    if not 0 < abs(value) < 1e-2:
        return f"{value:.3f}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def percent(fraction: float) -> str:
    return f"{100 * fraction:.0f}\N{NO-BREAK SPACE}%"


def task_name(score: TrialScore) -> str:
    return f"{score.action} {score.region.replace('_', ' ')}".capitalize()


def sorted_scores(scores: Iterable[TrialScore]) -> list[TrialScore]:
    return sorted(scores, key=lambda s: (s.task_id, s.seed, s.trial_id))


def summary_rows(scores: Sequence[TrialScore]) -> list[SummaryRow]:
    """One row a task in task order, then one over all trials; empty without scores.

    Trials in which the harness failed are in no count; a task that has no other keeps its row, with n = 0.
    Raises ConfigError if the scores mix protocols, policies or worlds.
    """
    check_one_run(scores)
    if not scores:
        return []
    ordered = sorted_scores(scores)
    tasks: dict[str, list[TrialScore]] = {}
    for score in ordered:
        tasks.setdefault(score.task_id, []).append(score)
    rows = [_row(task_id, task_name(group[0]), group) for task_id, group in tasks.items()]
    return [*rows, _row(POOLED, "All trials", ordered)]


def markdown_table(scores: Sequence[TrialScore]) -> str:
    """GitHub-flavoured table of ``summary_rows``; medians, with valid n where it is not n."""
    lines = [COLUMNS, tuple(["---"] * 2 + ["---:"] * (len(COLUMNS) - 2))]
    lines += [tuple(cell.replace("|", "\\|") for cell in row.cells()) for row in summary_rows(scores)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _row(task_id: str, name: str, group: Sequence[TrialScore]) -> SummaryRow:
    group = judged(group)
    return SummaryRow(
        task_id=task_id,
        name=name,
        n=len(group),
        success=sum(s.c3_success for s in group),
        region_correct=sum(s.region_correct for s in group),
        safety_gated=sum(s.safety_gated for s in group),
        c1_n=median(s.c1_peak_force_n for s in group),
        c2_rad=median(s.c2_joint_margin_rad for s in group if s.action == "push"),
        c4=median(s.c4_motion_activity for s in group),
        c5_n=median(s.c5_force_sd_n for s in group),
    )


NAMED = 10
"""Trials that a sentence names before it only counts them."""


def listed(names: Sequence[str]) -> str:
    """The first NAMED, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")
