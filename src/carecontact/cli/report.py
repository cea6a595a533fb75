"""``carecontact report``: the page about one run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from carecontact.cli.groups import Folder, Switch


@dataclass(frozen=True, kw_only=True)
class Report:
    """Rewrite report.html of a run from its results.json and its recordings."""

    folder: Folder
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of blind baselines on the same protocol. The report shows their success rates beside this run, and keeps
    them when you write it again; name others to replace them."""
    rescore: Switch = False
    """Compute the scores again from the recordings in place of reading results.json, which stays as it is."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.report_page import write_page
        from carecontact.cli.rescoring import need_recordings
        from carecontact.cli.stored import read_run

        need_recordings(self.folder)
        write_page(self.folder, read_run(self.folder, rescore=self.rescore), baselines=self.baseline)
        return 0
