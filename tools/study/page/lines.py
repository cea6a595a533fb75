"""One line of a comparison as the cells of a table."""

from __future__ import annotations

from tools.study.page.markdown import p_value

from carecontact.reports.compare.outcomes import plain_text
from carecontact.reports.compare.paired_lines import Line, ScoreLine
from carecontact.reports.compare.verdicts import few_seeds


def line_cells(line: Line) -> list[str]:
    outcome = line.outcome
    interval = interval_text(line)
    unit = "" if outcome.unit == "1" else f" [{outcome.unit}]"
    return [
        f"{outcome.title}{unit}", plain_text(outcome, line.a.estimate), plain_text(outcome, line.b.estimate),
        f"{plain_text(outcome, line.difference.estimate)}{interval}", str(_pairs(line)),
        p_value(line.test.pvalue), p_value(line.p_holm), _detectable(line),
    ]  # fmt: skip


def interval_text(line: Line) -> str:
    low, high = line.difference.low, line.difference.high
    if low is None or high is None:
        return ""
    return f" [{plain_text(line.outcome, low)}, {plain_text(line.outcome, high)}]"


def _pairs(line: Line) -> int:
    return line.difference.n if isinstance(line, ScoreLine) else line.n_pairs


def _detectable(line: Line) -> str:
    if line.detectable is None:
        return "too few seeds to tell" if few_seeds(line) else "not to be told"
    return "none" if line.detectable.difference is None else plain_text(line.outcome, line.detectable.difference)
