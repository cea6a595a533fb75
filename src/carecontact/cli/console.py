"""The terminal that tables are printed to."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def console(width: int) -> Console:
    """As wide as the terminal or as COLUMNS says; ``width`` columns where the output goes elsewhere without COLUMNS."""
    from rich.console import Console

    class OurConsole(Console):
        def on_broken_pipe(self) -> None:
            """For the command to answer as it does elsewhere: rich's own answer is status 1, that of a failed check."""
            raise BrokenPipeError

    known = "COLUMNS" in os.environ or Console().is_terminal
    return OurConsole(highlight=False, markup=False, width=None if known else width)


def plain_table() -> Table:
    """A table without lines, under bold heads."""
    from rich.table import Table

    return Table(box=None, pad_edge=False, header_style="bold")


def p_text(value: float | None) -> str:
    """A p-value with three decimals, small ones in powers of ten."""
    if value is None:
        return "NA"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
