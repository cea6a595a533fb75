"""``carecontact score``: from recordings to numbers, without a simulator."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, Folder, JsonGroup, Switch
from carecontact.errors import counted

if TYPE_CHECKING:
    from carecontact.runs.append import Appended
    from carecontact.runs.run_scores import RunScores


@dataclass(frozen=True, kw_only=True)
class Score:
    """Compute the scores of a run again from its recordings and write results.json. This needs no simulator."""

    folder: Folder
    append: Switch = False
    """Only add the metrics that results.json does not have yet; everything in it stays as it is."""
    allow_missing: Switch = False
    """Replace results.json even if planned trials have no recording that can be scored."""
    jobs: int | None = None
    """Number of processes; default: one per core, or a smaller number if there are few recordings."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if a recording was skipped, or if results.json stays because planned trials are missing."""
        from carecontact.cli.rescoring import rescore
        from carecontact.runs.alone import alone

        with alone(self.folder):
            if self.append:
                return self._appended(append(self.folder))
            run = rescore(self.folder, jobs=self.jobs, allow_missing=self.allow_missing)
        status = 1 if run.skipped or (run.missing and not self.allow_missing) else 0
        self._say(run, wrote=bool(run.scores) and (self.allow_missing or not run.missing), status=status)
        return status

    def _appended(self, found: Appended) -> int:
        from carecontact.runs.stored_scores import beside_plan, read_results

        status = 1 if found.gone else 0
        if self.output.json:
            run = beside_plan(self.folder, read_results(found.path))
            self._say(run, wrote=bool(found.metrics), status=status, added=found.metrics)
        return status

    def _say(self, run: RunScores, *, wrote: bool, status: int, added: list[str] | None = None) -> None:
        if not self.output.json:
            return
        from carecontact.cli.answers.score import ScoreAnswer
        from carecontact.cli.json_lines import say
        from carecontact.cli.rescoring import RESULTS
        from carecontact.runs.results_content import results

        content = results(run)
        say(
            ScoreAnswer(
                folder=str(self.folder),
                results=str(self.folder / RESULTS) if wrote else None,
                added=added,
                skipped=run.skipped,
                missing=list(run.missing),
                overall=content["overall"] if run.scores else None,
                per_task=content["per_task"],
                status=status,
            )
        )


def append(folder: Path) -> Appended:
    """Add the metrics that results.json lacks. An error leaves the file unchanged."""
    from carecontact.cli.rescoring import RESULTS, need_recordings, write_table
    from carecontact.runs import append_metrics, read_results

    need_recordings(folder)
    found = append_metrics(folder)
    if found.metrics:
        print(f"added to {counted(found.trials, 'trial')}: {', '.join(found.metrics)}")
    else:
        print(f"nothing to add: {RESULTS} has every metric of this release")
    if found.gone:
        print(f"warning: no recording of {', '.join(found.gone)}; what {RESULTS} says of it stays as it was")
    if found.not_listed:
        others = ", ".join(found.not_listed)
        print(f"recordings that {RESULTS} does not list (run score without --append to include them): {others}")
    print(f"scores: {found.path}")
    if found.metrics:
        print(write_table(folder, read_results(found.path).scores))
    return found
