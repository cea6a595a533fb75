"""``carecontact merge``: one run of the parts that ``run --shard`` made."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro


@dataclass(frozen=True, kw_only=True)
class Merge:
    """Make one run of the parts that `carecontact run --shard` made on several machines, score it and write its report.
    The result is the same as that of one run."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the whole run: a new one, or one that more parts are added to."""
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Folders of the parts. They stay as they are."""

    after_interrupt: ClassVar[str] = "; give the same command again to continue"

    def __call__(self) -> int:
        """Return 1 if a planned trial has no recording, or a recording cannot be scored. Raises as ``merge_runs``."""
        from carecontact.cli.report_page import write_page
        from carecontact.cli.rescoring import rescore
        from carecontact.errors import ConfigError
        from carecontact.runs.alone import alone
        from carecontact.runs.merge import merge_runs

        if not self.runs:
            raise ConfigError("merge: expected a folder to write and the parts, for example merge runs/all runs/part-*")
        merged = merge_runs(self.out, self.runs)
        told = f", {merged.already} were there already" if merged.already else ""
        print(f"{len(self.runs)} part(s): {merged.copied} recording(s) copied into {self.out}{told}", flush=True)
        with alone(self.out):
            scores = rescore(self.out, compare=False)
            write_page(self.out, scores)
        return 1 if merged.missing or scores.skipped else 0
