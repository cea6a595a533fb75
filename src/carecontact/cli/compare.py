"""``carecontact compare``: runs side by side, without a simulator."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from carecontact.cli.groups import Switch
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.reports.compare.comparison import Comparison, RunInfo
    from carecontact.reports.compare.null_floors import NullFloors
    from carecontact.reports.compare.paired_lines import Line, RateLine, ScoreLine
    from carecontact.runs.run_scores import RunScores

RESULTS = "results.json"
COMPARISON, OVERVIEW = "comparison.json", "overview.json"
TESTS = ("paired", "Holm", "worst rank", "unpaired")
COLUMNS = ("", "A", "B", "A - B [95 %]", "pairs", *(f"p\n{test}" for test in TESTS), "verdict")
WIDTH = 158
"""Below it there is no table."""


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare runs of one protocol. Two runs: trial by trial, what differs and which differences could not have been
    seen. More runs: rates, every pair, and whether their ranking survives other gates. See docs/statistics.md."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN_A [RUN_B ...]")]
    """Folders of runs, or their results.json alone; differences are A minus B."""
    null: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of blind baselines: what they pass stands beside each run. With them one run is enough."""
    per_task: Switch = False
    """For two runs: print a table for each task too; the tables of the tasks are a family of their own."""
    out: Path | None = None
    """Folder for comparison.json (two runs) and overview.json (more, or blind baselines); default: write neither."""

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        return compare(self.runs, nulls=self.null, per_task=self.per_task, out=self.out)


def compare(runs: Sequence[Path], *, nulls: Sequence[Path], per_task: bool, out: Path | None) -> int:
    """Exit status 0 whatever is found; ConfigError if the runs cannot be compared."""
    if out is not None and out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    places = [path.resolve() for path in (*runs, *nulls)]
    twice = next((path for path in (*runs, *nulls) if places.count(path.resolve()) > 1), None)
    if twice is not None:
        raise ConfigError(f"{twice} is given twice; name different runs")
    if len(runs) < 2 and not nulls:
        raise ConfigError(f"{len(runs)} run is nothing to compare; name two or more, or one and --null RUN...")
    if per_task and len(runs) != 2:
        raise ConfigError("--per-task compares two runs; name two")
    scored = [read_scores(path) for path in runs]
    floors = _floors(scored, nulls)
    if len(runs) == 2:
        _compare_two(scored, runs, per_task=per_task, out=out)
    if len(runs) > 2 or nulls:
        _overview(scored, runs, floors, out=out)
    return 0


def _compare_two(scored: Sequence[RunScores], runs: Sequence[Path], *, per_task: bool, out: Path | None) -> None:
    from carecontact.reports.compare.comparison import compare_runs, comparison_json

    comparison = compare_runs(*scored, per_task=per_task)
    _print(comparison, *runs)
    if out is not None:
        print(f"comparison: {_write(comparison_json(comparison), out / COMPARISON)}")


def _floors(scored: Sequence[RunScores], nulls: Sequence[Path]) -> dict[str, NullFloors]:
    from carecontact.reports.compare.null_floors import null_floors

    arms = [read_scores(path) for path in nulls]
    return {letter: null_floors(run, arms) for letter, run in zip(ascii_uppercase, scored, strict=False) if arms}


def _overview(
    scored: Sequence[RunScores], runs: Sequence[Path], floors: Mapping[str, NullFloors], *, out: Path | None
) -> None:
    from carecontact.cli.overview import print_floors, print_overview
    from carecontact.reports.compare.overview import overview, overview_json

    found = overview(scored) if len(scored) > 2 else None
    if found is not None:
        print_overview(found, runs)
    for letter, of_run in floors.items():
        print_floors(of_run, letter if len(scored) > 1 else "")
    if out is not None:
        print(f"overview: {_write(overview_json(found, floors), out / OVERVIEW)}")


def read_scores(run: Path) -> RunScores:
    """Recomputed where there are recordings, else as results.json has them; with what was planned and not scored."""
    from carecontact.cli.score import beside_plan
    from carecontact.runs import read_results, score_run

    if run.is_file():
        return read_results(run)
    if not run.is_dir():
        raise ConfigError(f"{run}: no such folder; name the --out of a run, or its {RESULTS}")
    if any(run.glob("*.h5")):
        scored = score_run(run)
        if not scored.scores:
            why = next(iter(scored.skipped.values()))
            raise ConfigError(f"{run}: no recording could be scored; the first: {why}")
        return beside_plan(run, scored)
    if (run / RESULTS).is_file():
        return read_results(run / RESULTS)
    raise ConfigError(f"{run}: holds neither recordings (*.h5) nor {RESULTS}; name the --out of a run")


def _write(content: Mapping[str, Any], path: Path) -> Path:
    from carecontact.recording.writer import replace_file

    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False)
    replace_file(path, f"{text}\n".encode("ascii"))
    return path


def _print(comparison: Comparison, a: Path, b: Path) -> None:
    from carecontact.contract.protocol import protocol_title
    from carecontact.protocols.frozen_state import drifted_sha256
    from carecontact.reports.compare.verdicts import ALPHA

    pairing = comparison.pairing
    print(f"{protocol_title(comparison.protocol_id, comparison.overrides)} ({comparison.protocol_sha256[:12]})")
    if not comparison.overrides and (why := drifted_sha256(comparison.protocol_id, comparison.protocol_sha256)):
        print(f"protocol: {why}")
    for name, folder, info, alone in (
        ("A", a, comparison.a, pairing.unpaired_a),
        ("B", b, comparison.b, pairing.unpaired_b),
    ):
        print(f"{name}: {_run_text(info, folder)}{_alone_text(alone)}")
    n_tasks, n_seeds = len(pairing.tasks), len(pairing.seeds)
    print(f"{pairing.n} trials paired, {n_tasks} task{'s' * (n_tasks != 1)}, {n_seeds} seed{'s' * (n_seeds != 1)}")
    _print_lines(comparison.overall)
    for task, lines in (comparison.per_task or {}).items():
        print(f"\n{task}, {lines[0].n_pairs} pairs")
        _print_lines(lines)
    families = [f"{len(comparison.overall)} lines"]
    if comparison.per_task is not None:
        families.append(f"the {sum(map(len, comparison.per_task.values()))} lines of the tasks")
    print(f"\nverdicts: p Holm at most {ALPHA:g}, over {' and, apart, over '.join(families)}; see docs/statistics.md")


def _run_text(info: RunInfo, folder: Path) -> str:
    counts = [f"{info.n_trials} trial{'s' * (info.n_trials != 1)}"]
    if info.n_harness_errors:
        counts.append(f"{info.n_harness_errors} left out because the harness failed")
    if info.skipped:
        counts.append(f"{len(info.skipped)} recordings skipped")
    if info.n_missing:
        counts.append(f"unfinished: {info.n_missing} planned without a score")
    return f"{info.policy} ({', '.join(info.language_backend)}), {folder}: {', '.join(counts)}"


def _alone_text(alone: dict[str, str]) -> str:
    if not alone:
        return ""
    why = ", ".join(f"{k} {reason}" for reason, k in sorted(Counter(alone.values()).items()))
    names = ", ".join(list(alone)[:6]) + (", ..." if len(alone) > 6 else "")
    return f"; {len(alone)} without a partner (in the other: {why}): {names}"


def _print_lines(lines: Sequence[Line]) -> None:
    from rich.console import Console
    from rich.table import Table

    from carecontact.reports.compare.paired_lines import RateLine
    from carecontact.reports.table import NOT_DEFINED

    console = Console(highlight=False, markup=False, width=None if Console().is_terminal else WIDTH)
    rows = [_rate_cells(line) if isinstance(line, RateLine) else _score_cells(line) for line in lines]
    told = ["" if line.verdict is None else "; ".join([line.verdict.text, *line.notes]) for line in lines]
    if console.width < WIDTH:
        # A table that wraps inside its intervals cannot be read.
        for (name, a, b, difference, pairs, *pvalues), text in zip(rows, told, strict=True):
            tests = ", ".join(f"{p} {test}" for test, p in zip(TESTS, pvalues, strict=True) if p != NOT_DEFINED)
            console.print(f"{name}: A {a}, B {b}, A - B {difference}, {pairs} pairs; p {tests}")
            console.print(f"  {text}")
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in COLUMNS:
        table.add_column(header, justify="left" if header in ("", "verdict") else "right")
    for line, cells in zip(lines, rows, strict=True):
        table.add_row(*cells, line.verdict.word if line.verdict else "")
    console.print(table)
    for line, text in zip(lines, told, strict=True):
        name = line.outcome.title if isinstance(line, RateLine) else f"{line.outcome.id} {line.outcome.title}"
        console.print(f"  {name}: {text}", soft_wrap=True)


def _rate_cells(line: RateLine) -> list[str]:
    from carecontact.reports.table import NOT_DEFINED, number

    def rate(estimate: float | None, low: float, high: float) -> str:
        percent = None if estimate is None else 100 * estimate
        return f"{number(percent, 1)} [{100 * low:.1f}, {100 * high:.1f}]"

    return [
        f"{line.outcome.title} [%]",
        rate(line.a.estimate, line.a.low, line.a.high),
        rate(line.b.estimate, line.b.low, line.b.high),
        rate(line.difference.estimate, line.difference.low, line.difference.high),
        str(line.n_pairs),
        p_text(line.test.pvalue),
        p_text(line.p_holm),
        NOT_DEFINED,
        p_text(line.unpaired.pvalue),
    ]


def _score_cells(line: ScoreLine) -> list[str]:
    from carecontact.reports.compare.outcomes import plain_text

    def shown(value: float | None) -> str:
        return plain_text(line.outcome, value)

    unit = "" if line.outcome.unit == "1" else f" [{line.outcome.unit}]"
    found = line.difference
    interval = "" if found.low is None else f" [{shown(found.low)}, {shown(found.high)}]"
    return [
        f"{line.outcome.id}{unit}{', Push' * line.outcome.push_only}",
        *(f"{shown(m.estimate)}{f' (n={m.n_valid})' * (m.n_valid != m.n)}" for m in (line.a, line.b)),
        f"{shown(found.estimate)}{interval}",
        f"{found.n} of {line.n_pairs}" if found.n != line.n_pairs else str(found.n),
        p_text(line.test.pvalue),
        p_text(line.p_holm),
        p_text(line.worst_rank.pvalue),
        p_text(None if line.unpaired is None else line.unpaired.pvalue),
    ]


def p_text(value: float | None) -> str:
    if value is None:
        return "NA"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
