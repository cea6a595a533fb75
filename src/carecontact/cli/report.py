"""``carecontact report``: the page about one run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from carecontact.cli.groups import Folder


@dataclass(frozen=True, kw_only=True)
class Report:
    """Write report.html of a run again."""

    folder: Folder
    null: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of blind baselines on the same protocol: their rates of false success stand beside this run. They stay in
    the report when it is written again; naming others replaces them."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.score import report

        return report(self.folder, nulls=self.null)
