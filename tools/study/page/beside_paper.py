"""Rates and medians of every method, with the paper's."""

from __future__ import annotations

from collections.abc import Sequence

from tools.study.method import Method
from tools.study.page.markdown import escaped, label, percent, proportion, table
from tools.study.study import Study

from carecontact.reports.compare.outcomes import RATES, Outcome, plain_text
from carecontact.reports.paper.published import Paper, PaperMethod

NOTES = {
    "state-machine": "`state-machine`: the paper's language model stands behind `rules-v1` only in so far as the same "
    "prompt and options are given to written rules. Its depths and speeds were chosen on this scene, before the first "
    "full run ([state-machine](../state-machine.md)).",
    "voxposer": "`voxposer`: how long the end of a path is held is a number of ours and not of the method, and touches "
    "depend on it ([voxposer](../voxposer.md)).",
}
"""What a reader of the rates has to know of a method; numbers stand where they were measured."""


def beside_paper(found: Study, paper: Paper) -> str:
    scores = paper.scores()
    header = ("method", "from", "n", *(f"{r.title} [%]" for r in RATES), *map(_score_title, scores))
    rows: list[Sequence[str]] = []
    for name in dict.fromkeys((*found.methods, *paper.methods)):
        theirs, ours = paper.methods.get(name), found.methods.get(name)
        if theirs is not None:
            rows.append((theirs.title, "paper", str(paper.runs_per_method), *_paper_cells(theirs, scores)))
        if ours is not None:
            rows.append((escaped(label(ours)), "here", str(ours.head.n), *_cells(ours, scores)))
        else:
            rows.append((name, "here: not run", *[""] * (len(header) - 2)))
    return "\n\n".join(
        [
            "## Beside the paper",
            "Rates with 95 % intervals (Wilson). Medians over the trials that have the score; C2 on Push. The paper's "
            "person, robot cell, perception and programs are not these: rows stand beside each other, they are not "
            "tested against each other. Paper: tables `tab:wilson_rates`, `tab:policy_results`.",
            table(header, rows, left=2),
            *(note for name, note in NOTES.items() if name in found.methods),
        ]
    )


def _score_title(outcome: Outcome) -> str:
    return outcome.id if outcome.unit == "1" else f"{outcome.id} [{outcome.unit}]"


def _paper_cells(method: PaperMethod, scores: Sequence[Outcome]) -> list[str]:
    rates = [percent(*method.rates[r.id]) for r in RATES]
    return [*rates, *(plain_text(s, method.medians[s.id]) for s in scores)]


def _cells(method: Method, scores: Sequence[Outcome]) -> list[str]:
    row = method.summary[-1]
    medians = {id_.partition("@")[0]: found for id_, found in row.medians.items()}
    cells = [
        plain_text(outcome, m.estimate) + (f" (n={m.n_valid})" if m.estimate is not None and m.n_valid != row.n else "")
        for outcome, m in ((outcome, medians[outcome.id]) for outcome in scores)
    ]
    return [*(proportion(method.rates[r.id]) for r in RATES), *cells]
