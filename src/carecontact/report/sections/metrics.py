"""Sections with numbers: counts and medians by task, the policies beside the run, and the load on the person."""

from __future__ import annotations

from typing import Any

from carecontact.report.baselines import ALL
from carecontact.report.failures import only_crashes
from carecontact.report.paired import RATES
from carecontact.report.run_page import FOLD, Page, section
from carecontact.report.tables import COUNTS, POOLED, SummaryRow, headlines, load, nursing_rows, summary_rows
from carecontact.report.words import NOT_DEFINED, enough_seeds, short_names, shown
from carecontact.runs.pooling import rate_of
from carecontact.runs.results_file import valid_ratio
from carecontact.scoring.limits import footnote
from carecontact.scoring.metrics.metric import METRICS


@section("tasks", "By task", order=FOLD + 10)
def tasks(page: Page) -> dict[str, Any] | None:
    if not page.judged:
        return None
    crashed = any(score.is_crash for score in page.judged)
    touched = sum(score.valid_contact for score in page.judged)
    metrics = headlines() if touched else []
    rates = COUNTS[COUNTS.index("n") + 1 :]
    return {
        "columns": ["n", *["crashed"] * crashed, *rates, *(metric.label for metric in metrics)],
        "only_crashes": only_crashes(page.judged),
        "rows": [
            (row, _cells(page, row, crashed=crashed, medians=bool(metrics)))
            for row in summary_rows(page.scores, page.unjudged)
        ],
        "pooled": POOLED,
        "metrics": metrics,
        "valid": valid_ratio(page.judged),
        "enough": enough_seeds(page.judged),
        "trials": page.trials,
        "unknown": len(page.unjudged),
        "touched": touched,
    }


def _cells(page: Page, row: SummaryRow, *, crashed: bool, medians: bool) -> list[tuple[str, str]]:
    """Return the text of each cell and a smaller one under it: interval of a pooled rate, or n of a median."""
    of_row = [score for score in page.judged if row.task_id in (score.task_id, POOLED)]
    found = [(row.trials, "")]
    if crashed:
        found.append((f"{sum(score.is_crash for score in of_row)}/{len(of_row)}", ""))
    for rate in RATES:
        interval = ""
        if row.task_id == POOLED and not row.unknown and enough_seeds(page.judged):
            proportion = rate_of(page.judged, rate.field)
            interval = f"{100 * proportion.low:.0f} to {100 * proportion.high:.0f} %"
        found.append((row.share(getattr(row, rate.id)), interval))
    for metric_id, median in row.medians.items() if medians else ():
        metric = METRICS[metric_id]
        defined = metric.actions is None or median.n
        text = shown(median.estimate, digits=metric.digits, unit=metric.unit) if defined else NOT_DEFINED
        found.append((text, "" if median.estimate is None else f"n = {median.n_valid}"))
    return found


@section("baselines", "Other policies", order=FOLD + 20)
def baselines(page: Page) -> dict[str, Any] | None:
    found = page.baselines
    if not page.judged or found is None:
        return None
    best = found.floor.get(ALL)
    return {
        "rows": [found.method, *found.baselines],
        "tasks": found.tasks,
        "floor": found.floor,
        "best": None if best is None else best.policy,
        "best_name": "best blind baseline" if all(at.blind for at in found.floor.values()) else "best baseline",
        "over_seeds": found.over == "seeds",
        "names": short_names([found.method.policy, *(row.policy for row in found.baselines)]),
        "enough": enough_seeds(page.judged),
        "fewer": any(row.whole is not None for row in found.baselines),
        "completed": " and ".join(found.completed),
        "shipped": ", ".join(found.kept),
        "machines": found.machines,
    }


@section("load", "How hard, how long", order=FOLD + 40)
def load_section(page: Page) -> dict[str, Any] | None:
    """The metrics that have no column in the table by task; none where no contact counted."""
    found = load(page.judged)
    if not found.rows or not any(score.valid_contact for score in page.judged):
        return None
    return {
        "load": found,
        "trials": page.trials if page.unjudged else "",
        "nursing": nursing_rows(page.judged, page.protocol),
        "note": footnote(row.metric.title for row in found.rows),
    }
