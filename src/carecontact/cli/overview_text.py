"""What ``carecontact compare`` prints of more than two runs, and of baselines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carecontact.reports.compare.baselines import Baselines, Passed
    from carecontact.reports.compare.overview import Overview, PairOfRuns
    from carecontact.reports.compare.rankings import Ranking
    from carecontact.reports.over_seeds import Over
    from carecontact.stats import RateDifference

RATE_NAMES = {"success": "success", "region_correct": "region-correct", "safety_gated": "safety-gated"}
WIDTH = 140


def print_overview(overview: Overview, runs: Sequence[Path]) -> None:
    """Print the overview of several runs.

    Args:
        runs: places of the runs, in the order of the overview.
    """
    from carecontact.contract.protocol import protocol_title

    print(f"{protocol_title(overview.protocol_id, overview.overrides)} ({overview.protocol_sha256[:12]})")
    for (letter, policy), folder in zip(overview.policies.items(), runs, strict=True):
        left = overview.left_out[letter]
        trials = "1 trial" if left == 1 else f"{left} trials"
        told = f": {trials} left out, because not every run has {'it' if left == 1 else 'them'}" if left else ""
        lacking = f": {overview.incomplete[letter]}" if letter in overview.incomplete else ""
        print(f"{letter}: {policy}, {folder}{lacking}{told}")
    print(f"{overview.n} trial{' that all runs have' if overview.n == 1 else 's that all runs have'}\n")
    _print_rows(overview)
    _print_pairs(overview.pairs, overview.over)
    for line in filter(None, (overview.rejected_tissue, overview.machines)):
        print(line)
    if overview.ranking is None:
        lacking = "; ".join(f"{letter} is {text}" for letter, text in overview.incomplete.items())
        print(f"\nnot ranked: {lacking}")
    else:
        _print_ranking(overview.ranking)


def _print_rows(overview: Overview) -> None:
    from carecontact.cli.console import console, plain_table
    from carecontact.reports.intervals import TOO_FEW, enough
    from carecontact.reports.table import headlines

    table = plain_table()
    table.add_column("")
    heads = [metric.label for metric in headlines()]
    for header in (*(name.replace("-", "-\n") + " [95 %]" for name in RATE_NAMES.values()), *heads):
        table.add_column(header, justify="right")
    for letter, row in overview.rows.items():
        rates = overview.rates[letter].values()
        cells = [_interval(100 * p.k / p.n, 100 * p.low, 100 * p.high, seeds=overview.seeds) for p in rates]
        table.add_row(
            f"{letter} (incomplete)" if letter in overview.incomplete else letter, *cells, *row.median_cells()
        )
    console(WIDTH).print(table)
    if not enough(overview.seeds):
        print(TOO_FEW)


def _print_pairs(pairs: Sequence[PairOfRuns], over: Over) -> None:
    from carecontact.cli.console import console, p_text, plain_table
    from carecontact.reports.compare.paired_lines import RateLine
    from carecontact.reports.compare.verdicts import ALPHA
    from carecontact.reports.over_seeds import OVER_TEXTS

    table = plain_table()
    for header in (
        "",
        "difference [95 %]",
        "pairs",
        "p McNemar" if over == "trials" else "p over seeds",
        "p Holm",
        "verdict",
    ):
        table.add_column(header, justify="right" if header.startswith(("diff", "p")) else "left")
    for pair in pairs:
        for line in pair.lines:
            assert isinstance(line, RateLine)
            word = "" if line.verdict is None else line.verdict.word
            word = {"A higher": f"{pair.a} higher", "B higher": f"{pair.b} higher"}.get(word, word)
            table.add_row(
                f"{pair.a} - {pair.b}, {line.outcome.title.lower()} [points]", _points(line.difference, line.n_seeds),
                str(line.n_pairs), p_text(line.test.pvalue), p_text(line.p_holm), word,
            )  # fmt: skip
    print()
    console(WIDTH).print(table)
    print(OVER_TEXTS[over])
    lines = sum(len(pair.lines) for pair in pairs)
    print(
        f"verdicts: a difference counts if its Holm-adjusted p-value over the {lines} rows is at most {ALPHA:g}; to "
        "compare scores as well, run compare with two runs only"
    )


def _print_ranking(ranking: Ranking) -> None:
    from carecontact.cli.console import console, plain_table

    print(f"\nranking by safety-gated trials: {', '.join(' = '.join(group) for group in ranking.order)}")
    table = plain_table()
    for header in ("changed setting", "smallest Kendall tau", "at"):
        table.add_column(header, justify="right" if header.startswith("smallest") else "left")
    for sweep, (least, level) in ranking.least_by_sweep().items():
        table.add_row(sweep, "no ranking" if least is None else f"{least:.2f}", level)
    console(WIDTH).print(table)
    print(
        "Kendall tau compares each ranking with that under the protocol's own gates: 1 is the same order, "
        "-1 the reverse order"
    )


ROLE_WORDS = {"privileged": " (ceiling)", "probe": " (probe)", "blind": " (blind)"}
"""Role of a policy -> words after its name in the table of baselines; a method has none."""


INTERVALS_OVER: dict[Over, str] = {
    "seeds": "over seeds (a seed is one person, whose trials are not independent)",
    "trials": "over trials, as if they were independent,",
}


def print_baselines(found: Baselines, letter: str) -> None:
    """Print the baselines beside a run.

    Args:
        letter: letter of the run among several; empty for one run alone.
    """
    from carecontact.cli.console import console, plain_table

    name = f"{letter} ({found.method.policy})" if letter else found.method.policy
    if not letter:
        print(found.protocol)
    if found.only_blind:
        print(f"\nblind baselines beside {name}: how often policies pass that cannot do the task")
    else:
        print(f"\nbaselines beside {name}")
    if any(row.role == "privileged" for row in found.baselines):
        print("a privileged policy is given the simulation: its rate is the ceiling, and it is never ranked")
    table = plain_table()
    table.add_column("")
    for header in ("trials", *RATE_NAMES.values(), f"{letter or 'method'} - baseline", "pairs", *found.tasks):
        table.add_column(header, justify="right")
    for row in (found.method, *found.baselines):
        table.add_row(*_baseline_cells(row, found.tasks))
    console(WIDTH).print(table)
    if (best := found.floor.get("all")) is not None:
        places = ", ".join(f"{task} {at.rate.k}/{at.rate.n}" for task, at in found.floor.items() if task != "all")
        blind = "best blind baseline" if best.blind else "best baseline (not registered as blind)"
        print(f"{blind}, safety-gated: {best.policy} {best.rate.k}/{best.rate.n}; of each task: {places}")
    if others := [row.policy for row in found.baselines if not row.n_pairs]:
        print(f"other seeds, no trial in common with {name}: {', '.join(others)}; their differences are unpaired")
    for line in filter(None, ("" if letter else found.rejected_tissue, found.machines)):
        print(line)
    print(
        f"rates in percent of trials, with 95 % intervals {INTERVALS_OVER[found.over]} where there are six seeds; "
        "difference: of the safety-gated rates, in percentage points; T1, T2, ...: safety-gated / trials"
    )


def _baseline_cells(row: Passed, tasks: Sequence[str]) -> list[str]:
    from carecontact.reports.text import NOT_DEFINED

    rates = [
        row.count(name) if row.unknown else _interval(100 * p.k / p.n, 100 * p.low, 100 * p.high, seeds=row.seeds)
        for name, p in row.rates.items()
    ]
    above = NOT_DEFINED if row.above is None else _points(row.above["safety_gated"], row.above_seeds or 0)
    pairs = NOT_DEFINED if row.n_pairs is None else str(row.n_pairs)
    counts = [row.per_task.get(task, {}).get("safety_gated") for task in tasks]
    return [
        row.policy + ROLE_WORDS.get(row.role, ""), row.trials, *rates, above, pairs,
        *(NOT_DEFINED if count is None else f"{count[0]}/{count[1]}" for count in counts),
    ]  # fmt: skip


def _points(found: RateDifference, seeds: int) -> str:
    """Return a difference in percentage points with its interval.

    Args:
        seeds: number of seeds that the difference rests on; with too few, there is no interval.
    """
    points = None if found.estimate is None else 100 * found.estimate
    return _interval(points, 100 * found.low, 100 * found.high, seeds=seeds)


def _interval(value: float | None, low: float, high: float, *, seeds: int) -> str:
    """``seeds``: that the value rests on; with too few there is no interval."""
    from carecontact.reports.intervals import enough
    from carecontact.reports.text import number

    return number(value, 1) + (f" [{low:.1f}, {high:.1f}]" if enough(seeds) else "")
