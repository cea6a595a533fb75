"""State-machine against voxposer, and what the paper proposes against voxposer."""

from __future__ import annotations

from collections.abc import Sequence

from tools.study.beside import Beside
from tools.study.page.lines import line_cells
from tools.study.page.markdown import count, escaped, label, p_value, table
from tools.study.plan import PAIR, PROPOSAL
from tools.study.study import Study

from carecontact.reports.compare.outcomes import plain_text
from carecontact.reports.compare.paired_lines import Line, ScoreLine
from carecontact.reports.compare.verdicts import POWER


def pair(found: Study) -> str:
    a, b = PAIR
    head = f"## {a} against {b}"
    if found.comparison is None:
        return f"{head}\n\nNot compared: a run of {a} or {b} is missing."
    pairing = found.comparison.pairing
    labels = [escaped(label(found.methods[name])) for name in PAIR]
    header = ("", *labels, "difference [95 %]", "pairs", "p", "p Holm", "detectable", "paper", "p (paper)",
              "unpaired p", "the difference is")  # fmt: skip
    family = len(found.comparison.overall)
    parts = [
        head,
        f"{pairing.n} pairs of trials with the same task and seed ({count(len(pairing.tasks), 'task')}, "
        f"{count(len(pairing.seeds), 'seed')}). Differences are {a} minus {b}; McNemar and Wilcoxon signed-rank, Holm "
        f"over the {family} lines of this comparison. Detectable: the smallest difference that this run would have "
        f"found with {POWER:.0%} power. Paper and unpaired: its values and its kinds of test (Fisher, Mann-Whitney; "
        "`tab:cross_tests`).",
        table(header, map(_beside_row, found.beside)),
        "\n".join(f"- {_told(row)}" for row in found.beside),
    ]
    alone = len(pairing.unpaired_a) + len(pairing.unpaired_b)
    if alone:
        parts.append(f"{count(alone, 'trial')} without a partner; the JSON names them.")
    return "\n\n".join(parts)


def proposal(found: Study) -> str:
    if found.proposal is None:
        return ""
    labels = [escaped(label(found.methods[name])) for name in PROPOSAL]
    header = ("", *labels, "difference [95 %]", "pairs", "p", "p Holm", "detectable")
    return "\n\n".join(
        [
            f"## {PROPOSAL[0]} against {PROPOSAL[1]}",
            "What the paper proposes, an objective of progress that takes over at the touch, against the method that "
            "it would change. The paper has no run of it. As above, with all lines of the comparison.",
            table(header, map(line_cells, found.proposal.overall)),
            *_equal_pairs(found.proposal.overall),
        ]
    )


def _equal_pairs(lines: Sequence[Line]) -> list[str]:
    """Where so many pairs are equal that the median difference is 0 whatever the others say."""
    return [
        f"{line.outcome.title}: {line.test.n - line.test.n_unequal} of {line.test.n} pairs are equal, so that the "
        "median difference stands still, and with it what could be detected; the test is over the others."
        for line in lines
        if isinstance(line, ScoreLine) and line.test.n_unequal and line.difference.standard_error == 0
    ]


def _beside_row(row: Beside) -> list[str]:
    outcome, line = row.outcome, row.line
    return [
        *line_cells(line), f"{plain_text(outcome, row.paper_a)} and {plain_text(outcome, row.paper_b)}",
        "not tested" if row.paper_test is None else p_value(row.paper_test[1]),
        p_value(None if line.unpaired is None else line.unpaired.pvalue), row.agreement,
    ]  # fmt: skip


def _told(row: Beside) -> str:
    assert row.line.verdict is not None
    notes = "".join(f"; {note}" for note in row.line.notes)
    text = row.line.verdict.text
    for letter, name in zip("AB", PAIR, strict=True):
        text, notes = text.replace(f"{letter} higher", f"{name} higher"), notes.replace(f" {letter} is", f" {name} is")
    return f"{row.outcome.title}: {text}{notes}. {row.agreement.capitalize()}."
