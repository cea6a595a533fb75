"""What ``carecontact compare`` prints of more than two runs, and of null arms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.cli.compare import p_text

if TYPE_CHECKING:
    from rich.console import Console

    from carecontact.reports.compare.null_floors import Floor, NullFloors
    from carecontact.reports.compare.overview import Overview
    from carecontact.reports.compare.rankings import Ranking
    from carecontact.stats import RateDifference

RATE_NAMES = {"success": "success", "region_correct": "region-correct", "safety_gated": "safety-gated"}
WIDTH = 140


def print_overview(overview: Overview, runs: Sequence[Path]) -> None:
    from rich.table import Table

    from carecontact.contract.protocol import protocol_title
    from carecontact.reports.compare.paired_lines import RateLine
    from carecontact.reports.compare.verdicts import ALPHA
    from carecontact.reports.table import COLUMNS
    from carecontact.stats import wilson_interval

    console = _console()
    print(f"{protocol_title(overview.protocol_id, overview.overrides)} ({overview.protocol_sha256[:12]})")
    for (letter, policy), folder in zip(overview.policies.items(), runs, strict=True):
        left = overview.left_out[letter]
        told = f": {left} trial{'s' * (left != 1)} that not all runs have left out" if left else ""
        print(f"{letter}: {policy}, {folder}{told}")
    print(f"{overview.n} trials that all runs have\n")

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for header in (*(f"{name} [95 %]" for name in RATE_NAMES.values()), *COLUMNS[-4:]):
        table.add_column(header, justify="right")
    for letter, row in overview.rows.items():
        rates = [wilson_interval(k, row.n) for k in (row.success, row.region_correct, row.safety_gated)]
        table.add_row(
            letter, *(_interval(100 * p.k / p.n, 100 * p.low, 100 * p.high) for p in rates), *row.cells()[-4:]
        )
    console.print(table)

    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("", "difference [95 %]", "p McNemar", "p Holm", "verdict"):
        table.add_column(header, justify="right" if header.startswith(("diff", "p ")) else "left")
    for pair in overview.pairs:
        for line in pair.lines:
            assert isinstance(line, RateLine)
            word = "" if line.verdict is None else line.verdict.word
            word = {"A higher": f"{pair.a} higher", "B higher": f"{pair.b} higher"}.get(word, word)
            table.add_row(
                f"{pair.a} - {pair.b}, {line.outcome.title.lower()} [points]", _points(line.difference),
                p_text(line.test.pvalue), p_text(line.p_holm), word,
            )  # fmt: skip
    console.print()
    console.print(table)
    lines = sum(len(pair.lines) for pair in overview.pairs)
    print(f"verdicts: p Holm at most {ALPHA:g} over {lines} lines; scores of two runs: name the two alone")
    _print_ranking(console, overview.ranking)


def _print_ranking(console: Console, ranking: Ranking) -> None:
    from rich.table import Table

    print(f"\nranking by safety-gated trials: {', '.join(' = '.join(group) for group in ranking.order)}")
    table = Table(box=None, pad_edge=False, header_style="bold")
    for header in ("other choice of", "smallest Kendall tau", "at"):
        table.add_column(header, justify="right" if header.startswith("smallest") else "left")
    for sweep, (least, level) in ranking.least_by_sweep().items():
        table.add_row(sweep, "no order" if least is None else f"{least:.2f}", level)
    console.print(table)
    print("tau 1: the same order as under the protocol's own gates; -1: the reverse")


def print_floors(floors: NullFloors, letter: str) -> None:
    """``letter``: of the run among several; empty for one alone."""
    from rich.table import Table

    name = f"{letter} ({floors.method.policy})" if letter else floors.method.policy
    print(f"\nnull floors under {name}: what arms pass that cannot do the task")
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    table.add_column("trials", justify="right")
    for header in RATE_NAMES.values():
        table.add_column(header, justify="right")
    table.add_column(f"{letter or 'method'} - arm", justify="right")
    for task in floors.tasks:
        table.add_column(task, justify="right")
    for floor in (floors.method, *floors.nulls):
        table.add_row(*_floor_cells(floor, floors.tasks))
    _console().print(table)
    print("percent of trials, 95 % intervals; difference of safety-gated trials in points; T1 ...: successes of trials")


def _floor_cells(floor: Floor, tasks: Sequence[str]) -> list[str]:
    from carecontact.reports.table import NOT_DEFINED

    rates = [_interval(100 * p.k / p.n, 100 * p.low, 100 * p.high) for p in floor.rates.values()]
    above = NOT_DEFINED if floor.above is None else _points(floor.above["safety_gated"])
    counts = [floor.per_task.get(task, {}).get("success") for task in tasks]
    return [
        floor.policy, str(floor.n), *rates, above,
        *(NOT_DEFINED if count is None else f"{count[0]}/{count[1]}" for count in counts),
    ]  # fmt: skip


def _points(found: RateDifference) -> str:
    return _interval(None if found.estimate is None else 100 * found.estimate, 100 * found.low, 100 * found.high)


def _interval(value: float | None, low: float, high: float) -> str:
    from carecontact.reports.table import number

    return f"{number(value, 1)} [{low:.1f}, {high:.1f}]"


def _console() -> Console:
    from rich.console import Console

    return Console(highlight=False, markup=False, width=None if Console().is_terminal else WIDTH)
