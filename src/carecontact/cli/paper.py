"""``carecontact paper``: the paper's tables and figures, made from runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carecontact.contract.protocol import Protocol
    from carecontact.runs.run_scores import RunScores


@dataclass(frozen=True, kw_only=True)
class Paper:
    """Write the tables of the paper (as LaTeX, CSV and Markdown) and its figures (as SVG and PDF) from your runs, with
    the values that the paper prints beside yours. The same runs give the same bytes."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]
    """Folders of runs of one protocol, one policy each, or their results.json (also .json.gz) alone."""
    out: Path = Path("paper")
    """Folder for tables and figures."""
    no_figures: Switch = False
    """Write the tables only, and remove figures that an earlier command wrote into the folder."""

    after_interrupt: ClassVar[str] = "; what was written stays"

    def __call__(self) -> int:
        """Raises ConfigError for runs that cannot be read or must not stand in one table."""
        from carecontact.cli.stored import read_run
        from carecontact.reports.compare.comparable import check_complete, check_different
        from carecontact.reports.paper.build import remove_earlier, tables_of, write_tables
        from carecontact.runs.pooling import rejected_text

        if not self.runs:
            raise ConfigError("expected one or more runs; name their folders")
        if self.out.exists() and not self.out.is_dir():
            raise ConfigError(f"--out {self.out}: this is a file; name a folder")
        check_different(self.runs)
        runs = [read_run(path) for path in self.runs]
        check_complete({str(path): run for path, run in zip(self.runs, runs, strict=True)})
        for line in {text for run in runs if (text := rejected_text(run.scores))}:
            print(f"warning: {line}")
        protocol = _protocol(self.runs, runs)
        if protocol is None:
            print("no recording and no shipped protocol says what these runs ran: the tables of tasks and protocol are "
                  "left out")  # fmt: skip
        written = write_tables(tables_of(runs, protocol), self.out / "tables")
        if not self.no_figures:
            written += self._figures(runs)
        for path in written:
            print(path)
        for path in remove_earlier(self.out, written):
            print(f"removed {path}, which an earlier command had written")
        return 0

    def _figures(self, runs: Sequence[RunScores]) -> list[Path]:
        """Write the figures that the runs allow. Return their paths."""
        from carecontact.recording import read_recording
        from carecontact.reports.paper.build import write_figures

        folders = {number: path for number, path in enumerate(self.runs) if any(path.glob("*.h5"))}
        if not folders:
            print("no run has recordings: the figures of traces and of force and indentation are left out")
        read = {
            number: (lambda trial_id, folder=folder: read_recording(folder / f"{trial_id}.h5"))
            for number, folder in folders.items()
        }
        return write_figures(runs, read, self.out / "figures")


def _protocol(places: Sequence[Path], runs: Sequence[RunScores]) -> Protocol | None:
    """Return the protocol of the runs, from a recording or, if the hash is the same, from this release. Return None if
    neither has it."""
    from carecontact.protocols import load_protocol, shipped_protocols
    from carecontact.recording import read_header

    recording = next((file for place in places for file in sorted(place.glob("*.h5"))), None)
    if recording is not None:
        return read_header(recording).spec.protocol
    first = next((score for run in runs for score in run.scores), None)
    if first is None or first.overrides:
        return None
    name, _, level = first.protocol_id.partition(" ")
    if name not in shipped_protocols():
        return None
    found = load_protocol(name, level=level or None)
    return found if found.sha256 == first.protocol_sha256 else None
