"""Keep what a sweep found about one frozen protocol with levels: its tables, and the scores of every cell.

    python tools/keep_sweep.py runs/results [--out docs/results]
    python tools/keep_sweep.py runs/stiffness --changed stiffness [--out docs/results]
    python tools/keep_sweep.py runs/ensemble --scores-only ensemble [--out docs/results]

The folder is that of a finished ``carecontact sweep``. Writes PROTOCOL.md, which is the sweep's tables under a heading,
and packs the scores of each cell into ``PROTOCOL-LEVEL/POLICY.json.gz``, where ``carecontact compare`` and the report
find the shipped policies and the blind baselines that stand beside a run. Where a policy ran with several arguments on
one level, POLICY.json.gz has the one that passed most trials, and the others have their arguments in the name.

``--changed NAME`` is for a sweep that changes something in the protocol, of which no cell stands beside anybody's run.
It writes PROTOCOL-NAME.md, and the scores into ``sensitivity/PROTOCOL-NAME/CELL.json.gz``. ``--scores-only NAME`` is
for a sweep whose tables stand on another page: it writes the scores alone, into ``sensitivity/NAME-CELL.json.gz``. The
same cells give the same files.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import defaultdict
from pathlib import Path

from carecontact.errors import CarecontactError
from carecontact.runs.results_file import pack_results
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores

TOP = """# {protocol}: results

Seeds {seeds}, {trials} trials of each policy on each level. [What it means](README.md);
[the protocol](../bathing-wide.md); [the baselines](../baselines.md); [intervals and orders](../statistics.md).
`tools/keep_sweep.py` wrote this page from a run of [the plan](../../examples/cluster/results.toml), and keeps the
scores of every trial beside it.
"""
TOP_CHANGED = """# {protocol}: sweep of {what}

Seeds {seeds}, {trials} trials in each cell. [What it means](README.md#what-the-result-depends-on);
[the protocol](../bathing-wide.md); [the baselines](../baselines.md); [intervals and orders](../statistics.md).
`tools/keep_sweep.py` wrote this page from a run of [the plan](../../examples/cluster/{what}.toml), and keeps the scores
of every trial in [sensitivity](sensitivity).
"""


def best_first(runs: list[RunScores]) -> list[RunScores]:
    """Order the runs of one policy by how many trials they passed, and then by their titles."""
    return sorted(runs, key=lambda run: (-sum(s.safety_gated for s in run.scores), run.scores[0].policy_title))


def file_name(run: RunScores, *, best: bool) -> str:
    """Return the name of a file of kept scores, without suffix."""
    first = run.scores[0]
    return first.policy if best else re.sub(r"[^A-Za-z0-9._-]+", "-", first.policy_title)


def without_folders(tables: str) -> str:
    """Leave out the last column of the cells, the folders of the sweep, which are not beside the page."""
    before, title, rest = tables.partition("\n## Cells\n")
    cells, end, after = rest.partition("\n## ")
    return before + title + re.sub(r"(?m) [^|\n]* \|$", "", cells) + end + after


def cells_of(sweep: Path) -> dict[str, RunScores]:
    """Return the scores of a sweep's cells by the names of their folders.

    Raises:
        CarecontactError: a cell cannot be read, there is none, or they are of several protocols or seeds.
    """
    runs = {cell.name: read_scores(cell) for cell in sorted((sweep / "cells").glob("*")) if cell.is_dir()}
    if not runs:
        raise CarecontactError(f"{sweep}: no cells; expected the folder of a finished carecontact sweep")
    protocols = {run.scores[0].protocol_id.partition(" ")[0] for run in runs.values()}
    seeds = {tuple(sorted({score.seed for score in run.scores})) for run in runs.values()}
    sizes = {len(run.scores) for run in runs.values()}
    if len(protocols) != 1 or len(seeds) != 1 or len(sizes) != 1:
        raise CarecontactError(
            f"{sweep}: expected cells of one protocol with the same trials in each; run the rest first"
        )
    return runs


def write_page(page: Path, top: str, sweep: Path, runs: list[RunScores], **words: str) -> None:
    """Write the sweep's tables under a heading."""
    first, seeds = runs[0], sorted({score.seed for score in runs[0].scores})
    tables = without_folders((sweep / "sweep.md").read_text(encoding="utf-8").partition("\n")[2])
    heading = top.format(
        protocol=first.scores[0].protocol_id.partition(" ")[0], seeds=f"{seeds[0]} to {seeds[-1]}",
        trials=len(first.scores), **words,
    )  # fmt: skip
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(heading + tables, encoding="utf-8")


def keep(sweep: Path, out: Path) -> list[Path]:
    """Write the page and the scores of a sweep over levels, and return the files. Raises what ``cells_of`` raises."""
    runs = list(cells_of(sweep).values())
    files = [out / f"{runs[0].scores[0].protocol_id.partition(' ')[0]}.md"]
    write_page(files[0], TOP, sweep, runs)
    places: dict[tuple[str, str], list[RunScores]] = defaultdict(list)
    for run in runs:
        places[run.scores[0].protocol_id, run.scores[0].policy].append(run)
    for (level, _), alike in places.items():
        for number, run in enumerate(best_first(alike)):
            files.append(out / level.replace(" ", "-") / f"{file_name(run, best=number == 0)}.json.gz")
            files[-1].parent.mkdir(exist_ok=True)
            pack_results(files[-1], run)
    return files


def keep_changed(sweep: Path, out: Path, what: str) -> list[Path]:
    """Write the page and the scores of a sweep that changes the protocol, and return the files.

    Args:
        sweep: folder of the sweep.
        out: folder of the kept results.
        what: what was changed, which is also the name of the plan.

    Raises what ``cells_of`` raises.
    """
    runs = cells_of(sweep)
    name = f"{next(iter(runs.values())).scores[0].protocol_id.partition(' ')[0]}-{what}"
    files = [out / f"{name}.md"]
    write_page(files[0], TOP_CHANGED, sweep, list(runs.values()), what=what)
    for cell, run in runs.items():
        files.append(out / "sensitivity" / name / f"{cell.rpartition('_')[0]}.json.gz")
        files[-1].parent.mkdir(parents=True, exist_ok=True)
        pack_results(files[-1], run)
    return files


def keep_scores(sweep: Path, out: Path, name: str) -> list[Path]:
    """Write the scores of a sweep whose tables stand on another page, and return the files. Raises what ``cells_of``
    raises."""
    files: list[Path] = []
    for cell, run in cells_of(sweep).items():
        files.append(out / "sensitivity" / f"{name}-{cell.rpartition('_')[0]}.json.gz")
        files[-1].parent.mkdir(parents=True, exist_ok=True)
        pack_results(files[-1], run)
    return files


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweep", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--changed", metavar="NAME", help="what the sweep changed in the protocol")
    what.add_argument("--scores-only", metavar="NAME", help="write no page; NAME begins the names of the files")
    options = parser.parse_args(arguments)
    try:
        if options.changed:
            files = keep_changed(options.sweep, options.out, options.changed)
        elif options.scores_only:
            files = keep_scores(options.sweep, options.out, options.scores_only)
        else:
            files = keep(options.sweep, options.out)
    except CarecontactError as error:
        print(f"keep_sweep: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"keep_sweep: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    print(
        f"{len(files)} files of scores" if options.scores_only else f"{files[0]} and {len(files) - 1} files of scores"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
