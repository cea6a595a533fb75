"""``carecontact score``: from recordings to numbers, without a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from carecontact.cli.groups import Folder, Switch


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

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if a recording was skipped, or if results.json stays because planned trials are missing."""
        from carecontact.cli.rescoring import rescore
        from carecontact.runs.alone import alone

        with alone(self.folder):
            if self.append:
                return append(self.folder)
            run = rescore(self.folder, jobs=self.jobs, allow_missing=self.allow_missing)
        return 1 if run.skipped or (run.missing and not self.allow_missing) else 0


def append(folder: Path) -> int:
    """Add what results.json lacks; an error leaves it as it was. Returns 1 if a trial's recording is gone."""
    from carecontact.cli.rescoring import RESULTS, need_recordings, write_table
    from carecontact.runs import append_metrics, read_results

    need_recordings(folder)
    found = append_metrics(folder)
    if found.metrics:
        print(f"added to {found.trials} trial(s): {', '.join(found.metrics)}")
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
    return 1 if found.gone else 0
