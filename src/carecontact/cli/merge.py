"""``carecontact merge``: one run of the parts that ``run --shard`` made."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.errors import counted

if TYPE_CHECKING:
    from carecontact.runs.merge import Merged


@dataclass(frozen=True, kw_only=True)
class Merge:
    """Make one run of the parts that `carecontact run --shard` made on several machines, score it and write its report.
    The result is the same as that of one run. Parts of a sweep become one sweep."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the whole run or sweep: a new one, or one that more parts are added to."""
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Folders of the parts. They stay as they are."""

    after_interrupt: ClassVar[str] = "; give the same command again to continue"

    def __call__(self) -> int:
        """Return 1 if a planned trial has no recording, or a recording cannot be scored. Raises as ``merge_runs``."""
        from carecontact.cli.rescoring import rescore
        from carecontact.errors import ConfigError
        from carecontact.runs.alone import alone
        from carecontact.runs.merge import merge_runs
        from carecontact.runs.sweep.merge import is_sweep

        if not self.runs:
            raise ConfigError("merge: expected a folder to write and the parts, for example merge runs/all runs/part-*")
        if any(map(is_sweep, self.runs)):
            return self._merge_sweeps()
        merged = merge_runs(self.out, self.runs)
        self._say("", [merged])
        with alone(self.out):
            scores = rescore(self.out, compare=False, page=True)
        return 1 if merged.missing or scores.skipped else 0

    def _merge_sweeps(self) -> int:
        from carecontact.cli.cell_scores import store, stored
        from carecontact.reports.text import listed
        from carecontact.runs.sweep.cells import CELLS
        from carecontact.runs.sweep.merge import merge_sweeps

        merged = merge_sweeps(self.out, self.runs)
        self._say(f", {counted(len(merged), 'cell')}", list(merged.values()))
        status = 0
        for name, cell in merged.items():
            folder = self.out / CELLS / name
            if any(folder.glob("*.h5")):
                store(folder, anew=False)
            run = stored(folder)
            lines = [f"skipped {file}: {why}" for file, why in run.skipped.items()] if run else []
            if cell.missing:
                lacking = counted(len(cell.missing), "planned trial has", "planned trials have")
                lines.append(f"{lacking} no recording: {listed(cell.missing)}")
            for line in lines:
                print(f"{folder}: {line}")
                status = 1
        print(f"for the table: carecontact sweep PLAN.toml --out {shlex.quote(str(self.out))} --table-only")
        return status

    def _say(self, cells: str, merged: list[Merged]) -> None:
        copied, already = (sum(getattr(each, name) for each in merged) for name in ("copied", "already"))
        told = f", {already} were there already" if already else ""
        parts, recordings = counted(len(self.runs), "part"), counted(copied, "recording")
        print(f"{parts}{cells}: {recordings} copied into {self.out}{told}", flush=True)
