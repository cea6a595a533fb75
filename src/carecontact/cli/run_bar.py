"""The bar of a run on a terminal, with lines under it for what has no room beside it in 80 columns."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from carecontact.cli.tally import Tally

MOST_WAITING = 4
"""Largest number of lines about silent policies that are shown at the same time."""


class RunBar(Progress):
    """The bar and the time left; under it the counts, each policy that does not answer, and the trials that run."""

    def __init__(self, tally: Tally, *, console: Console | None = None) -> None:
        self._tally = tally
        columns = (TextColumn("trials"), BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn())
        super().__init__(*columns, TextColumn("{task.description}"), console=console)
        self._row = self.add_task("", total=None)

    def get_renderables(self) -> Iterator[RenderableType]:
        yield from super().get_renderables()
        yield from (Text(line, no_wrap=True, overflow="ellipsis") for line in self._lines())

    def advance_to(self, done: int, total: int) -> None:
        self.update(self._row, completed=done, total=total, description=self._tally.left())

    def _lines(self) -> Iterator[str]:
        yield self._tally.counts()
        waiting = self._tally.waiting()
        yield from waiting[:MOST_WAITING]
        if len(waiting) > MOST_WAITING:
            yield f"and {len(waiting) - MOST_WAITING} more wait for their policies"
        if running := self._tally.running():
            yield f"running: {' '.join(running)}"
