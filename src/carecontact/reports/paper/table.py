"""A table of text cells, and how it is written as LaTeX, CSV and Markdown."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from math import ceil

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
