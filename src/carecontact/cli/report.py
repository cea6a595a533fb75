"""``carecontact report``: the page about one run, and the pages of its trials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores

Place = Annotated[
    Path,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="DIR", help="The --out folder of a run, or one recording in it (TRIAL.h5)."),
]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Rewrite report.html of a run from its results.json and its recordings; of a recording, write the page of its
    trial."""

    place: Place
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of blind baselines on the same protocol. The report shows their success rates beside those of this run.
    Later reports of this run show the same baselines, until you name others."""
    rescore: Switch = False
    """Compute the scores again from the recordings in place of reading results.json, which stays as it is."""
    trials: Switch = False
    """Write the page of every trial as well, trial/T1-s000.html and so on. The report links the pages that are
    there."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        from carecontact.cli.report_page import write_page
        from carecontact.cli.rescoring import need_recordings
        from carecontact.cli.stored import read_run
        from carecontact.cli.trial_pages import write_trial_pages
        from carecontact.runs.alone import alone

        if self.place.is_file():
            return self._one_trial()
        with alone(self.place):
            need_recordings(self.place)
            run = read_run(self.place, rescore=self.rescore)
            _need_rows(self.place, run)
            if self.trials:
                write_trial_pages(self.place, run, baselines=self.baseline)
            print(*write_page(self.place, run, baselines=self.baseline), sep="\n")
        return 0

    def _one_trial(self) -> int:
        """Write the page of one trial. Raises ConfigError for an option that only a run's report has."""
        from carecontact.cli.trial_pages import write_page_of

        if self.place.suffix != ".h5":
            raise ConfigError(
                f"{self.place}: report takes the folder of a run, or one recording in it (TRIAL.h5); name "
                f"{self.place.parent}"
            )
        given = [name for name, on in (("--baseline", self.baseline), ("--trials", self.trials)) if on]
        if given:
            raise ConfigError(f"{given[0]} belongs to the report of a run: name its folder, {self.place.parent}")
        print(f"page of the trial: {write_page_of(self.place)}")
        return 0


def _need_rows(folder: Path, run: RunScores) -> None:
    """Check that there is something to show.

    Raises ConfigError if no recording could be scored, and RecordingError, which names the recording and its
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
