"""A table of text cells, and how it is written as LaTeX, CSV and Markdown."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip
ABSENT = "-"
"""Stands in a cell without a value: the paper prints none, or there is nothing to compute it from."""


@dataclass(frozen=True, kw_only=True)
class Table:
    name: str
    """Of its files, without an ending."""
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raises ValueError for a row that is not as long as the head."""
        wrong = next((row for row in self.rows if len(row) != len(self.head)), None)
        if wrong is not None:
            raise ValueError(f"table {self.name}: {len(wrong)} cells under {len(self.head)} heads: {wrong}")

    def csv(self) -> str:
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([self.head, *self.rows])
        return stream.getvalue()

    def markdown(self) -> str:
        lines = [f"**{self.caption}**", "", *map(_markdown_row, (self.head, ("---",) * len(self.head), *self.rows))]
        return "\n".join([*lines, *(f"\n{note}" for note in self.notes)]) + "\n"

    def latex(self) -> str:
        """A table environment; it needs the packages booktabs and tabularx."""
        # A wide table takes both columns of a page.
        float_, width = ("table*", "textwidth") if len(self.head) > 5 else ("table", "columnwidth")
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
    return "".join(LATEX.get(character, character) for character in text)
