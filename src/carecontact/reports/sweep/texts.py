"""The table of a sweep as CSV, for programs, and as Markdown, for a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from carecontact.errors import counted
from carecontact.reports.intervals import TOO_FEW, enough, enough_seeds
from carecontact.reports.sweep.band_texts import flip_heads, flip_rows, spread_heads, spread_rows
from carecontact.reports.sweep.gate_texts import gate_heads, gate_rows, gate_titles
from carecontact.reports.sweep.level_texts import (
    CONTRAST_HEADS,
    FACTOR_HEADS,
    LEVEL_HEADS,
    contrast_rows,
    factor_rows,
    level_rows,
    task_heads,
    task_rows,
)
from carecontact.reports.sweep.provenance import HEADS, provenance
from carecontact.reports.sweep.stability import Order, Stability
from carecontact.reports.sweep.table import PASSED, RATES, CellRow, SweepTable
from carecontact.reports.table import headlines
from carecontact.reports.text import NA, NOT_DEFINED, listed, percent
from carecontact.runs.aggregate import rate
from carecontact.runs.pooling import judged
from carecontact.scoring.metrics.metric import Metric


def as_csv(table: SweepTable) -> str:
    """Return one row for each cell; percentages are not rounded. A cell without trials has empty fields, one in which
    planned trials have no verdict has no percentages, and one with fewer than SEEDS_FOR_INTERVAL seeds has no
    intervals."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    metrics = headlines()
    rates = [(name, f"{name}_pc", f"{name}_pc_low", f"{name}_pc_high") for name in RATES]
    writer.writerow(
        ["policy", *table.axes, "folder", "planned", "trials", "crashed", "harness_errors",
         *(column for of_rate in rates for column in of_rate), *(f"median_{_field(metric)}" for metric in metrics)]
    )  # fmt: skip
    for row in table.rows:
        cell = row.cell
        writer.writerow([cell.label, *cell.values.values(), cell.folder, cell.planned, *_numbers(row, metrics)])
    return stream.getvalue()


def _numbers(row: CellRow, metrics: Sequence[Metric]) -> list[object]:
    counts = row.counts
    if counts is None:
        return [0, 0, 0, *[""] * (4 * len(RATES) + len(metrics))]
    out: list[object] = [counts.n, row.crashed, row.harness_errors]
    for name in RATES:
        found = rate(getattr(counts, name), counts.n, unknown=counts.unknown)
        between = found["pc_ci95"] if counts.unknown or enough_seeds(judged(row.cell.scores)) else ["", ""]
        out += [found["n"], "" if found["pc"] is None else found["pc"], *between]
    return out + [counts.medians[metric.id].estimate for metric in metrics]


def _field(metric: Metric) -> str:
    return metric.field or metric.id


def heads(table: SweepTable) -> list[str]:
    """Return heads of the columns of ``cells``."""
    return ["policy", *table.axes, "trials", *RATES.values(), *(metric.label for metric in headlines())]


def cells(row: CellRow) -> list[str]:
    """Return the cells of a row, as tables for people show them."""
    role = row.cell.role
    label = row.cell.label if role == "method" else f"{row.cell.label} ({role})"
    left = [label, *row.cell.values.values()]
    if row.counts is None:
        planned = row.cell.planned
        return [*left, f"0/{planned}", *[f"0–{planned}/{planned}"] * len(RATES), *[NA] * len(headlines())]
    counts = row.counts
    trials = str(counts.n) if counts.n == row.cell.planned else f"{counts.n}/{row.cell.planned}"
    rates = [counts.share(getattr(counts, name)) for name in RATES]
    # A table of one policy in each row has one sign for what has no value.
    return [*left, trials, *rates, *(NA if text == NOT_DEFINED else text for text in counts.median_cells())]


def as_markdown(table: SweepTable) -> str:
    lines = [f"# Sweep {table.title}", "", *sentences(table), ""]
    if table.stability is not None:
        lines += ["## Order of the policies", "", *_markdown(ORDER_HEADS, map(order_cells, table.stability.orders)), ""]
        lines += [*_markdown(marginal_heads(table), marginal_rows(table)), ""]
    for title, head, rows in level_tables(table):
        lines += [f"## {title}", "", *_markdown(head, rows), ""]
    # The folder is the last column, because a copy of the table elsewhere does without it.
    rows = [[*cells(row), f"`{row.cell.folder}`"] for row in table.rows]
    lines += ["## Cells", "", *_markdown([*heads(table), "folder"], rows), ""]
    lines += ["## Provenance", "", *_markdown(HEADS, provenance(table)), ""]
    return "\n".join(lines)


def sentences(table: SweepTable) -> list[str]:
    """Return the sentences above the tables."""
    policies = "1 policy" if len(table.policies) == 1 else f"{len(table.policies)} policies"
    told = [f"{counted(len(table.rows), 'cell')} of {policies}, {_trials(table)}."]
    if table.unfinished:
        told.append(
            f"Incomplete: {counted(table.unfinished, 'cell')} {_verb(table.unfinished, 'lacks', 'lack')} the verdict "
            "on planned trials; each count there goes from all of these failed to all of them passed, and the policy "
            "is not ranked. Spreads and medians are of the trials with a verdict. The same command repeats the others."
        )
    failed = sum(row.harness_errors for row in table.rows)
    if failed:
        told.append(
            f"The harness failed in {counted(failed, 'trial')}, which {_verb(failed, 'has', 'have')} no verdict."
        )
    found = table.stability
    if not enough({score.seed for row in table.rows for score in row.cell.scores}):
        told.append(f"There are {TOO_FEW}.")
    if found is None:
        told.append("There is no order of policies: it needs a trial of the same task and seed of two policies.")
        return told
    told.append(
        f"{_order(found)}, by the share of {PASSED[table.rank_by]} trials that all of them ran ({found.n} each)."
    )
    if found.groups > 1:
        told.append(_held(found))
    unfinished = {row.cell.label for row in table.rows if row.cell.unknown}
    if others := [n for name, n in table.named.items() if name not in found.passed and name not in unfinished]:
        told.append(f"Not ranked, because they are no methods: {listed(others)}.")
    return told


def _verb(n: int, one: str, more: str) -> str:
    return one if n == 1 else more


def _trials(table: SweepTable) -> str:
    done, planned = (sum(len(row.cell.scores) for row in table.rows), sum(row.cell.planned for row in table.rows))
    return f"{done} of {counted(planned, 'trial')}" if done < planned else counted(done, "trial")


def _order(found: Stability) -> str:
    parts: list[str] = []
    names = list(found.passed)
    for before, name in zip([None, *names], names, strict=False):
        equal = before is not None and found.passed[before] == found.passed[name]
        sign = "" if before is None else " = " if equal else " > "
        parts.append(f"{sign}{name} ({percent(found.passed[name] / found.n)})")
    return "".join(parts)


def _held(found: Stability) -> str:
    held = f"The whole order is the same in {found.same} of {found.groups} combinations of the axes"
    if not found.taus:
        return f"{held}; no combination orders the policies at all."
    least, middle = min(found.taus), sorted(found.taus)[len(found.taus) // 2]
    unordered = f"; {found.unordered} order nothing" if found.unordered else ""
    return f"{held}. Kendall's tau with the overall order: least {least:.2f}, median {middle:.2f}{unordered}."


ORDER_HEADS = (
    "policies", "difference", "combinations: higher", "equal", "lower", "resampled seeds: higher", "equal", "lower",
)  # fmt: skip


def order_cells(order: Order) -> list[str]:
    resampled = (order.resampled_higher, order.resampled_equal, order.resampled_lower)
    return [
        f"{order.a} - {order.b}",
        f"{100 * order.difference:+.0f} points",
        *(str(count) for count in (order.higher, order.equal, order.lower)),
        *(NA if share is None else f"{100 * share:.1f} %" for share in resampled),
    ]


def ranked(table: SweepTable) -> list[str]:
    """Return the policies that the order is about, in the order of the plan."""
    return [name for name in table.policies if table.stability and name in table.stability.passed]


def marginal_heads(table: SweepTable) -> list[str]:
    return ["axis", "value", "trials of each policy", *ranked(table), "tau with the overall order"]


def marginal_rows(table: SweepTable) -> list[list[str]]:
    found = table.stability
    return [
        [row.axis, row.value, str(row.n), *(percent(row.passed[name] / row.n) for name in ranked(table)),
         NA if row.tau is None else f"{row.tau:.2f}"]
        for row in (found.marginals if found is not None else ())
    ]  # fmt: skip


def level_tables(table: SweepTable) -> list[tuple[str, Sequence[str], list[list[str]]]]:
    """Return title, heads and rows of what the table has of draws, levels, factors and gates."""
    found: list[tuple[str, Sequence[str], list[list[str]]]] = []
    if table.bands is not None:
        found.append(("Spread over the draws", spread_heads(), spread_rows(table.bands, table.named)))
        found.append(("Draws in which two policies change places", flip_heads(), flip_rows(table.bands)))
    if table.ladder is not None:
        found.append(("Success over level", LEVEL_HEADS, level_rows(table.ladder)))
        found.append(("By task", task_heads(table.ladder), task_rows(table.ladder)))
        found.append(("Methods against each other", CONTRAST_HEADS, contrast_rows(table.ladder)))
    if table.factors is not None:
        found.append(("One factor at a time", FACTOR_HEADS, factor_rows(table.factors)))
    titles = gate_titles([score for row in table.rows for score in row.cell.scores])
    found.append(("The order under other gates", gate_heads(table.gate_orders), gate_rows(table.gate_orders, titles)))
    return [one for one in found if one[2]]


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]] | map[list[str]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines]
