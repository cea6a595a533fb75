"""A comparison of two runs as the terminal shows it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import counted

if TYPE_CHECKING:
    from carecontact.policies.registry import Role
    from carecontact.reports.compare.comparison import Comparison, RunInfo
    from carecontact.reports.compare.paired_lines import Line, RateLine, ScoreLine

TESTS = ("paired", "Holm", "worst rank", "unpaired")
COLUMNS = ("", "A", "B", "A - B [95 %]", "pairs", *(f"p\n{test}" for test in TESTS), "verdict")
WIDTH = 174
"""Least width of the terminal [columns] at which a table is printed."""


ROLE_WORDS = {
    "privileged": "given the simulation: a ceiling, and no method",
    "blind": "a blind baseline, and no method",
    "probe": "a probe, and no method",
}
"""Role of a policy -> what is said of it; a method needs no word."""


def print_comparison(
    comparison: Comparison, a: Path, b: Path, *, crashed: Sequence[str] = ("", ""),
    roles: Sequence[Role] = ("method", "method"),
) -> None:  # fmt: skip
    """Print the comparison of two runs.

    Args:
        comparison: the comparison of the runs in ``a`` and ``b``.
        a: place of the run A.
        b: place of the run B.
        crashed: the trials in which the policy crashed, for A and for B; empty if there are none.
        roles: the roles of both policies.
    """
    from carecontact.contract.protocol import protocol_title
    from carecontact.protocols.frozen_state import drifted_sha256
    from carecontact.reports.compare.verdicts import ALPHA
    from carecontact.reports.intervals import TOO_FEW, enough
    from carecontact.reports.over_seeds import OVER_TEXTS

    pairing = comparison.pairing
    _say(f"{protocol_title(comparison.protocol_id, comparison.overrides)} ({comparison.protocol_sha256[:12]})")
    if not comparison.overrides and (why := drifted_sha256(comparison.protocol_id, comparison.protocol_sha256)):
        _say(f"protocol: {why}")
    for name, folder, info, alone, of_run, role in (
        ("A", a, comparison.a, pairing.unpaired_a, crashed[0], roles[0]),
        ("B", b, comparison.b, pairing.unpaired_b, crashed[1], roles[1]),
    ):
        remarks = "".join(f"; {remark}" for remark in (ROLE_WORDS.get(role), of_run) if remark)
        _say(f"{name}: {_run_text(info, folder)}{remarks}{_alone_text(alone)}")
    tasks, seeds = counted(len(pairing.tasks), "task"), counted(len(pairing.seeds), "seed")
    _say(f"{counted(pairing.n, 'trial')} paired, {tasks}, {seeds}")
    for line in filter(None, (comparison.rejected_tissue, comparison.machines)):
        _say(line)
    heads = [_head("A", comparison.a), _head("B", comparison.b)]
    _print_lines(comparison.overall, heads)
    for task, lines in (comparison.per_task or {}).items():
        _say(f"\n{task}, {counted(lines[0].n_pairs, 'pair')}")
        _print_lines(lines, heads)
    if not enough(len(pairing.seeds)):
        _say(f"\n{TOO_FEW}; run more seeds")
    _say(f"\n{OVER_TEXTS[comparison.over]}")
    families = [f"{len(comparison.overall)} rows"]
    if comparison.per_task is not None:
        families.append(f"the {sum(map(len, comparison.per_task.values()))} rows of the tasks")
    _say(
        f"verdicts: a difference counts if its Holm-adjusted p-value is at most {ALPHA:g}; corrected over "
        f"{' and separately over '.join(families)}; see docs/statistics.md"
    )


def _say(text: str) -> None:
    """Print a text, wrapped between words on a narrow terminal and as one line elsewhere."""
    from carecontact.cli.console import console

    terminal = console(WIDTH)
    terminal.print(text, soft_wrap=terminal.width >= WIDTH)


def _run_text(info: RunInfo, folder: Path) -> str:
    counts = [counted(info.n_trials, "trial")]
    if info.n_planned > info.n_trials:
        counts = [f"incomplete, {info.n_trials} of {counted(info.n_planned, 'planned trial')} have a verdict"]
    return f"{info.policy} ({', '.join(info.language_backend)}), {folder}: {', '.join(counts)}"


def _alone_text(alone: dict[str, str]) -> str:
    if not alone:
        return ""
    why = ", ".join(f"{k} {reason}" for reason, k in sorted(Counter(alone.values()).items()))
    names = ", ".join(list(alone)[:6]) + (", ..." if len(alone) > 6 else "")
    return f"; {len(alone)} without a partner in the other run ({why}): {names}"


def _head(name: str, info: RunInfo) -> str:
    """Return the head of a run's column: ``A``, or ``A, 15 of 18 trials``."""
    return name if info.n_planned == info.n_trials else f"{name}, {info.n_trials} of\n{info.n_planned} trials"


def _print_lines(lines: Sequence[Line], heads: Sequence[str]) -> None:
    """``heads``: of the columns of A and B."""
    from rich.padding import Padding

    from carecontact.cli.console import console, plain_table
    from carecontact.reports.compare.paired_lines import RateLine
    from carecontact.reports.text import NOT_DEFINED

    terminal = console(WIDTH)
    rows = [_rate_cells(line) if isinstance(line, RateLine) else _score_cells(line) for line in lines]
    words = [line.verdict.word if line.verdict else "" for line in lines]
    if terminal.width < WIDTH:
        # A table that wraps inside its intervals cannot be read.
        for (name, a, b, difference, pairs, *pvalues), word in zip(rows, words, strict=True):
            tests = ", ".join(f"{p} {test}" for test, p in zip(TESTS, pvalues, strict=True) if p != NOT_DEFINED)
            counted = "1 pair" if pairs == "1" else f"{pairs} pairs"
            terminal.print(f"{name}: {word}")
            of_a, of_b = (f"{head.replace(chr(10), ' ')}:" if "," in head else head for head in heads)
            terminal.print(Padding(f"{of_a} {a}, {of_b} {b}, A - B {difference}, {counted}; p {tests}", (0, 0, 0, 2)))
    else:
        table = plain_table()
        for header in (COLUMNS[0], *heads, *COLUMNS[3:]):
            table.add_column(header, justify="left" if header in ("", "verdict") else "right")
        for cells, word in zip(rows, words, strict=True):
            table.add_row(*cells, word)
        terminal.print(table)
    for why, names in _reasons(lines).items():
        _say(f"{why}: {', '.join(names)}")


def _reasons(lines: Sequence[Line]) -> dict[str, list[str]]:
    """Return the reason of each verdict with its notes -> the lines for which it holds. Verdicts that explain
    themselves are left out."""
    from carecontact.reports.compare.paired_lines import RateLine

    found: dict[str, list[str]] = {}
    for line in lines:
        if line.verdict is not None and (why := "; ".join([line.verdict.text, *line.notes])) != line.verdict.word:
            name = line.outcome.title if isinstance(line, RateLine) else line.outcome.id
            found.setdefault(why, []).append(name)
    return found


def _rate_cells(line: RateLine) -> list[str]:
    from carecontact.cli.console import p_text
    from carecontact.reports.intervals import enough
    from carecontact.reports.text import NOT_DEFINED, number

    def rate(estimate: float | None, low: float, high: float) -> str:
        percent = None if estimate is None else 100 * estimate
        return number(percent, 1) + (f" [{100 * low:.1f}, {100 * high:.1f}]" if enough(line.n_seeds) else "")

    found = line.difference
    return [
        f"{line.outcome.title} [%]",
        *(f"{p.k}/{p.n}: {rate(p.estimate, p.low, p.high)}" for p in (line.a, line.b)),
        rate(found.estimate, found.low, found.high),
        str(line.n_pairs),
        p_text(line.test.pvalue),
        p_text(line.p_holm),
        NOT_DEFINED,
        p_text(line.unpaired.pvalue),
    ]


def _score_cells(line: ScoreLine) -> list[str]:
    from carecontact.cli.console import p_text
    from carecontact.reports.compare.outcomes import plain_text
    from carecontact.reports.intervals import enough

    def shown(value: float | None) -> str:
        return plain_text(line.outcome, value)

    actions = "" if line.outcome.actions is None else f", {' and '.join(line.outcome.actions).capitalize()}"
    unit = "" if line.outcome.unit == "1" else f" [{line.outcome.unit}]"
    found = line.difference
    interval = "" if found.low is None or not enough(line.n_seeds) else f" [{shown(found.low)}, {shown(found.high)}]"
    return [
        f"{line.outcome.id}{unit}{actions}",
        *(f"{shown(m.estimate)}{f' (n={m.n_valid})' * (m.n_valid != m.n)}" for m in (line.a, line.b)),
        f"{shown(found.estimate)}{interval}",
        f"{found.n} of {line.n_pairs}" if found.n != line.n_pairs else str(found.n),
        p_text(line.test.pvalue),
        p_text(line.p_holm),
        p_text(line.worst_rank.pvalue),
        p_text(None if line.unpaired is None else line.unpaired.pvalue),
    ]
