"""``carecontact report``: scores, report and pages of a run, from its recordings and without a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from carecontact.cli.console import print_answer
from carecontact.cli.groups import Switch, VerboseGroup, need_recordings, read_run
from carecontact.cli.parsing import given_options
from carecontact.errors import ConfigError, counted

if TYPE_CHECKING:
    from carecontact.runs.pooling import RunScores

RESULTS = "results.json"


@dataclass(frozen=True, kw_only=True)
class Report:
    """Show the scores of a run, and write its report.html from results.json and the recordings; of a recording, write
    the page of its trial. This needs no simulator."""

    place: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN|TRIAL.h5")]
    """The --out folder of a run, or one recording in it."""
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of blind baselines on the same protocol. The report shows their success rates beside those of this run.
    Later reports of this run show the same baselines, until you name others."""
    trials: Switch = False
    """Write the page of every trial as well, trial/T1-s000.html and so on. The report links the pages that are
    there."""
    rescore: Switch = False
    """Compute the scores again from the recordings, say what changed, and write results.json."""
    append: Switch = False
    """With --rescore: only add the metrics that results.json does not have yet; everything in it stays as it is."""
    allow_missing: Switch = False
    """With --rescore: replace results.json even if planned trials have no recording that can be scored."""
    jobs: int | None = None
    """With --rescore: number of processes; default: one per core, or a smaller number if there are few recordings."""
    output: VerboseGroup = field(default_factory=VerboseGroup)

    def __call__(self) -> int:
        """With --rescore, return 1 if a recording was skipped, or if planned trials are missing."""
        from carecontact.cli.publish import check_rows, publish, scores_of, write_trial_pages
        from carecontact.runs.lock import folder_lock

        options = [option for option in given_options(self) if option != "place"]
        if self.place.is_file():
            return self._write_one_page(options)
        if not self.rescore and (
            wrong := [name for name in options if name in ("--append", "--allow-missing", "--jobs")]
        ):
            raise ConfigError(f"{wrong[0]} belongs to `carecontact report --rescore`")
        with folder_lock(self.place):
            need_recordings(self.place)
            if self.append:
                return self._append(options)
            run = scores_of(self.place, jobs=self.jobs) if self.rescore else read_run(self.place)
            if not self.rescore:
                check_rows(self.place, run)
            if self.trials:
                write_trial_pages(self.place, run, baselines=self.baseline)
            wrote = publish(
                self.place,
                run,
                write=self.rescore,
                allow_missing=self.allow_missing,
                page=bool(run.scores),
                baselines=self.baseline,
                verbose=self.output.verbose,
            )
        status = 1 if self.rescore and (run.skipped or not wrote) else 0
        self._answer(run, wrote=wrote, status=status)
        return status

    def _write_one_page(self, options: Sequence[str]) -> int:
        if self.place.suffix != ".h5":
            raise ConfigError(
                f"{self.place}: report takes the folder of a run, or one recording in it (TRIAL.h5); name "
                f"{self.place.parent}"
            )
        if options:
            raise ConfigError(f"{options[0]} belongs to the report of a run: name its folder, {self.place.parent}")
        from carecontact.cli.publish import write_page_of

        print(f"page of the trial: {write_page_of(self.place)}")
        return 0

    def _append(self, options: Sequence[str]) -> int:
        """Add the metrics that results.json lacks. An error leaves the file unchanged."""
        from carecontact.cli.publish import write_table
        from carecontact.runs import append_metrics, read_results
        from carecontact.runs.scoring import beside_plan

        if wrong := [name for name in options if name not in ("--rescore", "--append", "--json", "--verbose")]:
            raise ConfigError(f"{wrong[0]} does not go with --append, which adds to {RESULTS} and writes no page")
        found = append_metrics(self.place)
        if found.metrics:
            print(f"added to {counted(found.trials, 'trial')}: {', '.join(found.metrics)}")
        else:
            print(f"nothing to add: {RESULTS} has every metric of this release")
        if found.gone:
            print(f"warning: no recording of {', '.join(found.gone)}; what {RESULTS} says of it stays as it was")
        if found.not_listed:
            others = ", ".join(found.not_listed)
            print(f"recordings that {RESULTS} does not list (leave out --append to include them): {others}")
        print(f"scores: {found.path}")
        run = beside_plan(self.place, read_results(found.path))
        if found.metrics:
            print(write_table(self.place, run.scores))
        status = 1 if found.gone else 0
        self._answer(run, wrote=bool(found.metrics), status=status, added=found.metrics)
        return status

    def _answer(self, run: RunScores, *, wrote: bool, status: int, added: list[str] | None = None) -> None:
        if not self.output.json:
            return
        from carecontact.cli.result_answers import ScoreAnswer
        from carecontact.runs.results_file import results

        content = results(run)
        print_answer(
            ScoreAnswer(
                folder=str(self.place),
                results=str(self.place / RESULTS) if wrote else None,
                added=added,
                skipped=run.skipped,
                missing=list(run.missing),
                overall=content["overall"] if run.scores else None,
                per_task=content["per_task"],
                status=status,
            )
        )
