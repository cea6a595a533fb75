"""``carecontact report``: the page about one run, and the pages of its trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import CarecontactError, ConfigError, RecordingError, counted

if TYPE_CHECKING:
    from carecontact.report.trial_page import Beside
    from carecontact.runs.pooling import RunScores


# Write the pages of trials, for ``carecontact report``.


def write_page_of(file: Path) -> Path:
    """Score one recording, write the page of its trial into the folder ``trial`` beside it, and return the page's path.

    Raises RecordingError, naming the file, for one that cannot be read, scored or drawn.
    """
    from carecontact.recording import read_recording
    from carecontact.report.trial_page import write_trial_page
    from carecontact.runs.pooling import RunScores
    from carecontact.scoring import score_recording

    recording = read_recording(file)
    score = score_recording(recording)
    beside = policies_beside(file.parent, RunScores(scores=[score]))
    return write_trial_page(file.parent, recording, score, beside=beside)


def write_trial_pages(folder: Path, run: RunScores, *, baselines: Sequence[Path] = ()) -> None:
    """Write the page of every scored trial. A recording that cannot be drawn is named, and the others are drawn.

    Args:
        baselines: runs of blind baselines to show beside the trials; without any, those of the last report.
    """
    from carecontact.recording import open_recording
    from carecontact.report.links import FOLDER
    from carecontact.report.trial_page import write_trial_page

    beside, done = policies_beside(folder, run, baselines), 0
    for score in run.scores:
        try:
            recording = open_recording(folder / f"{score.trial_id}.h5", sha256=score.recording_sha256)
            write_trial_page(folder, recording, score, beside=beside)
            done += 1
        except RecordingError as error:
            print(f"no page of {score.trial_id}: {error}")
    print(f"pages of {counted(done, 'trial')}: {folder / FOLDER}")


def policies_beside(folder: Path, run: RunScores, baselines: Sequence[Path] = ()) -> list[Beside]:
    """Return the runs that the pages of trials show beside a run: the named baselines, or else those of its last
    report, and the kept scores of the shipped policies. One that cannot be read or compared is left out; the report
    says why."""
    from carecontact.report.baselines import check_baselines, completed_from_shipped_scores, shipped_scores_for
    from carecontact.report.trial_page import Beside
    from carecontact.runs.results_file import remembered
    from carecontact.runs.scoring import read_scores

    named: list[RunScores] = []
    found: list[Beside] = []
    try:
        places = list(baselines) or list(remembered(folder).values())
    except CarecontactError:
        places = []
    for place in places:
        try:
            scores = read_scores(place)
            check_baselines(run, [*named, scores])
        except CarecontactError:
            continue
        named.append(scores)
        found.append(Beside.of(completed_from_shipped_scores(run, scores), place if place.is_dir() else place.parent))
    kept, _ = shipped_scores_for(run, named)
    return [*found, *map(Beside.of, kept)]


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
        from carecontact.cli.groups import read_run
        from carecontact.cli.score import need_recordings, write_page
        from carecontact.runs.lock import folder_lock

        if self.place.is_file():
            return self._one_trial()
        with folder_lock(self.place):
            need_recordings(self.place)
            run = read_run(self.place, rescore=self.rescore)
            _need_rows(self.place, run)
            if self.trials:
                write_trial_pages(self.place, run, baselines=self.baseline)
            print(*write_page(self.place, run, baselines=self.baseline), sep="\n")
        return 0

    def _one_trial(self) -> int:
        """Write the page of one trial. Raises ConfigError for an option that only a run's report has."""

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
    from carecontact.interface.regions import REGIONS
    from carecontact.protocol.gates import BEHAVIOURS
    from carecontact.recording import read_header

    if not run.scores:
        why = next(iter(run.skipped.values()), "there are none")
        raise ConfigError(f"{folder}: no recording can be scored, so no report is written; the first: {why}")
    for score in run.scores:
        if score.action not in BEHAVIOURS or score.region not in REGIONS:
            read_header(folder / f"{score.trial_id}.h5")
