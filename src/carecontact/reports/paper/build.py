"""Write the paper's tables and figures of some runs into a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from carecontact.contract.protocol import Protocol
from carecontact.recording.schema import Recording
from carecontact.recording.writer import replace_file
from carecontact.reports.compare.comparable import check_comparable
from carecontact.reports.paper.figures import indentation, outcomes, overview, traces
from carecontact.reports.paper.figures.style import NO_DATE, write_figure
from carecontact.reports.paper.method import Method, methods_of
from carecontact.reports.paper.other_rules import other_rules
from carecontact.reports.paper.published import read_paper
from carecontact.reports.paper.table import Table
from carecontact.reports.paper.tables.anatomy import anatomy
from carecontact.reports.paper.tables.contrasts import contrasts
from carecontact.reports.paper.tables.fixed import capability, metrics, tasks
from carecontact.reports.paper.tables.protocol import protocol_table
from carecontact.reports.paper.tables.rates import rates
from carecontact.reports.paper.tables.scores import scores
from carecontact.runs.run_scores import RunScores

TABLES = ("capability", "tasks", "metrics", "protocol", "rates", "scores", "tests", "anatomy")
FIGURES = ("overview", "traces", "force-indentation", "outcomes")
Read = Callable[[str], Recording]
"""Reads the recording of a trial of one run."""


def tables_of(runs: Sequence[RunScores], protocol: Protocol | None) -> list[Table]:
    """Return the tables of runs of one protocol.

    Args:
        runs: each of one policy.
        protocol: what they ran; None if it is unknown, which leaves two tables out.

    Raises ConfigError, naming what differs, if the runs must not stand in one table.
    """
    check_comparable({f"{number} ({run.scores[0].policy if run.scores else 'no policy'})": run.scores
                      for number, run in enumerate(runs, start=1)})  # fmt: skip
    paper = read_paper()
    methods = methods_of(runs, paper)
    note = other_rules(methods, protocol)
    found = [
        capability(paper),
        None if protocol is None else tasks(protocol, paper, methods),
        metrics(paper),
        None if protocol is None else protocol_table(protocol, paper, methods),
        rates(methods, note=note),
        scores(methods, paper, note=note),
        contrasts(methods, paper, note=note),
        anatomy(methods, note=note),
    ]
    return [table for table in found if table is not None]


def write_tables(tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write each table as NAME.tex, NAME.csv and NAME.md. Returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for table in tables:
        for ending, text in (("tex", table.latex()), ("csv", table.csv()), ("md", table.markdown())):
            written.append(folder / f"{table.name}.{ending}")
            replace_file(written[-1], text.encode())
    return written


def write_figures(runs: Sequence[RunScores], read: Mapping[int, Read], folder: Path) -> list[Path]:
    """Write the figures that the runs allow: without recordings, those of traces and indentation are left out.

    Args:
        runs: each of one policy, of one protocol.
        read: number of a run in ``runs`` -> what reads its recordings, for the runs that have them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    methods = methods_of(runs, read_paper())
    shown = {number: _one_of_each_task(methods[number], read[number]) for number in read}
    drawn: dict[str, Callable[..., None]] = {"overview": overview.draw}
    if shown:
        first = next(iter(shown.values()))
        every = [recording for recordings in shown.values() for recording in recordings]
        drawn["traces"] = partial(traces.draw, recordings=first)
        drawn["force-indentation"] = partial(indentation.draw, recordings=every)
    paths = [shown.get(number, []) for number in range(len(methods))]
    drawn["outcomes"] = partial(outcomes.draw, methods=methods, paths=paths)
    return [path for name, draw in drawn.items() for path in write_figure(draw, folder, name)]


def remove_earlier(folder: Path, written: Sequence[Path]) -> list[Path]:
    """Remove the tables and figures in a folder that an earlier build wrote and this one did not: they are of other
    runs. Returns their paths.

    Args:
        folder: the one that holds ``tables`` and ``figures``.
        written: what this build wrote.
    """
    known = [folder / "tables" / f"{name}.{ending}" for name in TABLES for ending in ("tex", "csv", "md")]
    known += [folder / "figures" / f"{name}.{ending}" for name in FIGURES for ending in NO_DATE]
    earlier = [path for path in known if path not in written and path.is_file()]
    for path in earlier:
        path.unlink()
    return earlier


def _one_of_each_task(method: Method, read: Read) -> list[Recording]:
    """Return one trial of each task: the first that succeeded, or else the first that touched, or else the first."""
    found: list[Recording] = []
    for task in sorted({score.task_id for score in method.scores}):
        of_task = sorted((s for s in method.scores if s.task_id == task), key=lambda s: s.seed)
        best = min(of_task, key=lambda s: (not s.c3_success, not s.valid_contact, s.seed))
        found.append(read(best.trial_id))
    return found
