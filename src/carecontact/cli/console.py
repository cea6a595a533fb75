"""The terminal that tables are printed to."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def console(width: int) -> Console:
    """Return a console as wide as the terminal or as the variable COLUMNS says.

    Args:
        width: number of columns if the output does not go to a terminal and COLUMNS is not set.
    """
    from rich.console import Console

    known = "COLUMNS" in os.environ or Console().is_terminal
    return Console(highlight=False, markup=False, width=None if known else width)


def plain_table() -> Table:
    """Return a table with bold headings and without lines."""
    from rich.table import Table

    return Table(box=None, pad_edge=False, header_style="bold")


def p_text(value: float | None) -> str:
    """Return a p-value with three decimals, or as a power of ten if it is small."""
    if value is None:
        return "NA"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
