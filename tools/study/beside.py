"""What is found here of state-machine against voxposer, beside what the paper has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tools.study.plan import PAIR, PRIMARY

from carecontact.reports.compare.comparison import Comparison
from carecontact.reports.compare.outcomes import Outcome
from carecontact.reports.compare.paired_lines import Line
from carecontact.reports.paper.published import Paper

Agreement = Literal["as in the paper", "against the paper", "not seen here", "open"]


@dataclass(frozen=True, kw_only=True)
class Beside:
    """One outcome of state-machine against voxposer: what is found here and what the paper has."""

    outcome: Outcome
    line: Line
    paper_a: float
    paper_b: float
    paper_test: tuple[str, float] | None
    """Test and p; None where the paper has none"""
    agreement: Agreement


def beside(comparison: Comparison, paper: Paper) -> list[Beside]:
    a, b = (paper.methods[name] for name in PAIR)
    rows: list[Beside] = []
    for line in comparison.overall:
        outcome = line.outcome
        if outcome.id in PRIMARY:
            there = a.value(outcome) - b.value(outcome)
            rows.append(
                Beside(
                    outcome=outcome, line=line, paper_a=a.value(outcome), paper_b=b.value(outcome),
                    paper_test=paper.pvalues.get(outcome.id), agreement=_agreement(line, there),
                )
            )  # fmt: skip
    return rows


def _agreement(line: Line, in_paper: float) -> Agreement:
    """``open``: this comparison could have missed a difference that matters."""
    assert line.verdict is not None
    if line.verdict.word in ("A higher", "B higher"):
        return "as in the paper" if (in_paper > 0) == (line.verdict.word == "A higher") else "against the paper"
    return "not seen here" if line.verdict.word == "no difference detected" else "open"
