"""The paper's methods as runs give them, its published values, and a table in three formats."""

from __future__ import annotations

import csv
import io
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

from carecontact.report.paired import RATES, Outcome, score_outcomes
from carecontact.runs.pooling import RunScores, judged
from carecontact.scoring.result import TrialScore

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip
MATH = re.compile(
    r"(?<![\w.])(?P<factor>-?\d+(?:\.\d+)?)e(?P<power>[+-]\d+)"
    r"|(?<![\w.)])-(?P<negative>\d+(?:\.\d+)?)"
    r"|(?P<method>\bpi0\.5\b)"
)
"""A number with a power of ten, a number below zero, and the name of a method."""
PAGE_COLUMN = 60
"""Characters that a column of a page holds in LaTeX's footnote size."""
PAGE_LINES = 45
"""Lines that a table in one column of a page has at most."""
GAP = 2
"""Characters that the space between two columns of a table takes."""
ABSENT = "-"
"""Stands in a cell without a value: the paper prints none, or there is nothing to compute it from."""


@dataclass(frozen=True, kw_only=True)
class Table:
    name: str
    """Name of its files, without an ending."""
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    numbers: tuple[tuple[object, ...], ...] = ()
    """A head, and rows with one value in each column (None: no value): what the CSV file has where cells hold several
    numbers. Empty: the CSV file has the cells."""

    def __post_init__(self) -> None:
        """Raises ValueError for a row that is not as long as its head."""
        for head, *rows in ((self.head, *self.rows), self.numbers or ((),)):
            wrong = next((row for row in rows if len(row) != len(head)), None)
            if wrong is not None:
                raise ValueError(f"table {self.name}: {len(wrong)} cells under {len(head)} heads: {wrong}")

    def csv(self) -> str:
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(self.numbers or [self.head, *self.rows])
        return stream.getvalue()

    def markdown(self) -> str:
        lines = [f"**{self.caption}**", "", *map(_markdown_row, (self.head, ("---",) * len(self.head), *self.rows))]
        return "\n".join([*lines, *(f"\n{note}" for note in self.notes)]) + "\n"

    @property
    def is_wide(self) -> bool:
        """Whether it needs more than one column of a page: LaTeX does not break the cells of its first column, gives
        the others equal widths, and breaks no table across pages."""
        first, *others = zip(self.head, *self.rows, strict=True)
        if not others:
            return False
        share = (PAGE_COLUMN - max(map(len, first))) / len(others) - GAP
        longest = max(len(word) for column in others for cell in column for word in cell.split() or [""])
        lines = sum(max(ceil(len(cell) / max(share, 1)) for cell in row[1:]) for row in (self.head, *self.rows))
        return longest > share or lines > PAGE_LINES

    def latex(self) -> str:
        """Return a table environment; it needs the packages booktabs and tabularx."""
        float_, width = ("table*", "textwidth") if self.is_wide else ("table", "columnwidth")
        columns = "l" + r">{\raggedright\arraybackslash}X" * (len(self.head) - 1)
        body = [_latex_row(self.head), r"\midrule", *map(_latex_row, self.rows)]
        notes = (
            [r"\par\raggedright\scriptsize", *(f"{_escaped(note)}\\par" for note in self.notes)] if self.notes else []
        )
        return "\n".join(
            [
                f"\\begin{{{float_}}}[t]", r"\centering", f"\\caption{{{_escaped(self.caption)}}}",
                f"\\label{{tab:{self.name}}}", r"\footnotesize",
                f"\\begin{{tabularx}}{{\\{width}}}{{{columns}}}", r"\toprule", *body, r"\bottomrule",
                r"\end{tabularx}", *notes, f"\\end{{{float_}}}", "",
            ]
        )  # fmt: skip


def _markdown_row(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _latex_row(cells: tuple[str, ...]) -> str:
    return " & ".join(map(_escaped, cells)) + r" \\"


def _escaped(text: str) -> str:
    """Return the text for LaTeX, with numbers and names in mathematics where they need it."""
    parts: list[str] = []
    end = 0
    for found in MATH.finditer(text):
        parts += [_plain(text[end : found.start()]), _mathematics(found)]
        end = found.end()
    return "".join([*parts, _plain(text[end:])])


def _mathematics(found: re.Match[str]) -> str:
    if found["method"]:
        return r"$\pi_{0.5}$"
    if found["negative"]:
        return f"$-{found['negative']}$"
    return f"${found['factor']} \\times 10^{{{int(found['power'])}}}$"


def _plain(text: str) -> str:
    return "".join(LATEX.get(character, character) for character in text)


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


@dataclass(frozen=True, kw_only=True)
class Method:
    policy: str
    title: str
    """The paper's name of the method, or else the policy with its arguments."""
    scores: list[TrialScore]
    """Scores of the trials that say something about the policy."""
    published: PaperMethod | None
    """The paper's values; None for a method that is not in the paper."""


def methods_of(runs: Sequence[RunScores], paper: Paper) -> list[Method]:
    """Return one method for each run, in their order; two of one title get a number."""
    found: list[Method] = []
    for run in runs:
        first = run.scores[0]
        published = paper.methods.get(first.policy)
        title = published.title if published and not first.policy_arguments else first.policy_title
        same = sum(method.title.partition(" (")[0] == title for method in found)
        found.append(
            Method(
                policy=first.policy,
                title=f"{title} ({same + 1})" if same else title,
                scores=judged(run.scores),
                published=published,
            )
        )
    return found
