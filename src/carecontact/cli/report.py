"""``carecontact report``: the page about one run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import Folder, Switch
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores


@dataclass(frozen=True, kw_only=True)
class Report:
    """Rewrite report.html of a run from its results.json and its recordings."""

    folder: Folder
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of blind baselines on the same protocol. The report shows their success rates beside those of this run.
    Later reports of this run show the same baselines, until you name others."""
    rescore: Switch = False
    """Compute the scores again from the recordings in place of reading results.json, which stays as it is."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.report_page import write_page
        from carecontact.cli.rescoring import need_recordings
        from carecontact.cli.stored import read_run
        from carecontact.runs.alone import alone

        with alone(self.folder):
            need_recordings(self.folder)
            run = read_run(self.folder, rescore=self.rescore)
            _need_rows(self.folder, run)
            write_page(self.folder, run, baselines=self.baseline)
        return 0


def _need_rows(folder: Path, run: RunScores) -> None:
    """Raises ConfigError where no recording could be scored, and RecordingError, which names the recording and its
    package, for an action or a region that nothing here registers: the report that is there stays."""
    from carecontact.contract.protocol import BEHAVIOURS
    from carecontact.recording import read_header
    from carecontact.regions import REGIONS

    if not run.scores:
        why = next(iter(run.skipped.values()), "there are none")
        raise ConfigError(f"{folder}: no recording can be scored, so no report is written; the first: {why}")
    for score in run.scores:
        if score.action not in BEHAVIOURS or score.region not in REGIONS:
            read_header(folder / f"{score.trial_id}.h5")
