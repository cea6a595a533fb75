"""The results of a sweep as text."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterable, Mapping, Sequence
from html import unescape
from itertools import pairwise

from carecontact import __version__
from carecontact.errors import counted
from carecontact.report.run_page import render
from carecontact.report.sweep_levels import Factors, GateOrder, Ladder
from carecontact.report.sweep_table import PASSED, RATES, Band, Bands, CellRow, Order, Stability, SweepTable
from carecontact.report.tables import headlines
from carecontact.report.words import NA, NOT_DEFINED, TOO_FEW, enough, enough_seeds, listed, percent, shown
from carecontact.runs.plan import compact
from carecontact.runs.pooling import judged
from carecontact.runs.results_file import share_passed
from carecontact.scoring.gate_sweep import sweeps_of
from carecontact.scoring.metrics.metric import Metric
from carecontact.scoring.result import TrialScore
from carecontact.stats import PersonDifference, PersonRate, WorstShare

HEADS = ("what", "value")
DIGITS = 12
"""Number of digits of a hash that tables show."""
WORLD = ("world", "kernel", "perception", "noise", "robot", "mujoco")
"""Parts of the simulated world that every trial of a sweep shares."""


def provenance(table: SweepTable) -> list[list[str]]:
    """Return rows under HEADS; those of which nothing is known are left out."""
    scores = [score for row in table.rows for score in row.cell.scores]
    protocols = {score.protocol_title: score.protocol_sha256[:DIGITS] for score in scores}
    titles = {row.cell.label: score.policy_title for row in table.rows for score in row.cell.scores}
    versions: dict[str, set[str]] = {}
    for row in table.rows:
        for package, found in row.cell.versions.items():
            versions.setdefault(package, set()).update(found)
    definitions = {f"{name} {version}" for s in scores for name, version in s.metric_versions.items()}
    worlds = {f"{name} {s.world[name][:DIGITS]}" for s in scores for name in WORLD if name in s.world}
    rows = {
        "plan": table.title,
        "protocols, with their hashes": listed([f"{title} ({sha256})" for title, sha256 in protocols.items()]),
        "policies": listed([name if name == title else f"{name}: {title}" for name, title in titles.items()]),
        "tasks": ", ".join(sorted({score.task_id for score in scores})),
        "seeds": compact({score.seed for score in scores}),
        "recordings": _recordings(score.recording_sha256 for score in scores),
        "world": ", ".join(sorted(worlds)),
        "definitions of the scores": ", ".join(sorted(definitions)),
        "recorded with": ", ".join(f"{name} {' and '.join(sorted(versions[name]))}" for name in sorted(versions)),
        "table written by": f"carecontact {__version__}",
    }
    return [[what, value] for what, value in rows.items() if value]


def _recordings(hashes: Iterable[str]) -> str:
    """Return how many values there are, and one hash of the hashes of all of them, whatever their order."""
    found = sorted(hashes)
    if not found:
        return ""
    together = hashlib.sha256("\n".join(found).encode("ascii")).hexdigest()
    return f"{counted(len(found), 'trial')}; hash of the hashes of all {together[:DIGITS]}"


OVER_PERSONS = (
    "Intervals are over persons: whole seeds are drawn, those of one body among themselves. Where all persons fare "
    "alike, the interval is that of as many trials as there are persons."
)
NOTES = {
    "Spread over the draws": (
        "A draw is one combination of the axes and one seed. Median and, in brackets, where there are six trials, the "
        "5th and 95th percentile over the trials of one task for which a score is defined; n where those are not all."
    ),
    "Draws in which two policies change places": (
        "In how many of the draws that both have, the two stand the other way round than over all of them, where "
        "passes are counted and medians compared: the chance that the order flips with the person who is drawn. "
        f"{NA}: the two are equal over all, or no draw has a number of both."
    ),
    "Success over level": (
        f"{OVER_PERSONS} Above the best blind: points above the blind baseline that passes most often at the level, "
        "over the same trials. Worst tenth: the mean rate of the tenth of the persons who fare worst; by chance: what "
        "it would be if all persons were alike. Harder band: trials that would pass narrower gates, which are no gate. "
        "Only methods are ranked, where there are two or more."
    ),
    "By task": "Passed trials of each task.",
    "Methods against each other": (
        "Points, over the trials that both have. The test permutes whole persons; its p-values are adjusted over all "
        "rows."
    ),
    "One factor at a time": (
        "Each factor of the hard level switched on alone on the easy level, and switched off alone on the hard one; "
        "differences in points, against the level with none and with all. A factor that breaks a policy has a negative "
        "first difference or a positive second one. The test permutes whole persons; its p-values are adjusted over "
        "all rows."
    ),
    "The order under other gates": (
        "The smallest Kendall's tau-b with the order under the protocol's own gates, over the values of each gate, and "
        "the value where it is; only the gates of the actions that ran. 1: the same order everywhere; -1: the reverse "
        "somewhere; NA: nothing is ordered."
    ),
}
"""Title of a table -> what it shows."""


def spread_rows(found: Bands, named: Mapping[str, str]) -> list[list[str]]:
    """``named``: policy -> its name with its role."""
    return [
        [
            named[one.policy],
            one.task,
            f"{one.passed}/{one.n}",
            *(_band(metric, one.bands[metric.id], of=one.n) for metric in headlines()),
        ]
        for one in found.spreads
    ]


def _band(metric: Metric, found: Band | None, *, of: int) -> str:
    if found is None:
        return NA
    low, middle, high = (
        shown(value, digits=metric.digits, unit=metric.unit) for value in (found.low, found.median, found.high)
    )
    between = f" [{low} to {high}]" if enough(found.n) else ""
    return f"{middle}{between}" + ("" if found.n == of else f" (n={found.n})")


def flip_rows(found: Bands) -> list[list[str]]:
    names = ["passed", *(metric.id for metric in headlines())]

    def share(k: int, n: int) -> str:
        return f"{k}/{n} ({percent(k / n)})"

    return [
        [f"{one.a} - {one.b}", one.task, *(share(*one.by[name]) if name in one.by else NA for name in names)]
        for one in found.flips
    ]


Rows = list[list[str]]
Table = tuple[str, Sequence[str], Rows]
"""Title, heads and rows."""

LEVEL_HEADS = (
    "level", "policy", "passed", "rate [95 %]", "above best blind", "worst tenth [95 %]", "by chance", "harder band",
)  # fmt: skip
CONTRAST_HEADS = ("level", "methods", "trials", "difference [95 %]", "p Holm")
FACTOR_HEADS = (
    "policy", "factor", "factor alone", "against none", "p Holm", "all but it", "against all", "p Holm",
)  # fmt: skip


def level_rows(found: Ladder) -> Rows:
    return [
        [
            level_name(rung.value),
            climb.policy if climb.role == "method" else f"{climb.policy} ({climb.role})",
            f"{climb.rate.k}/{climb.rate.n}",
            person_rate(climb.rate),
            "best blind" if climb.policy == rung.best_blind else difference(climb.above_blind),
            person_rate(climb.worst),
            NA if climb.worst.by_chance is None else f"{100 * climb.worst.by_chance:.0f} %",
            _counted(climb.harder),
        ]
        for rung in found.rungs
        for climb in rung.climbs
        if climb.rate.n
    ]


def task_rows(found: Ladder) -> Rows:
    return [
        [level_name(rung.value), climb.policy, *(_counted(climb.by_task.get(task)) for task in found.tasks)]
        for rung in found.rungs
        for climb in rung.climbs
        if climb.rate.n
    ]


def _counted(passed: tuple[int, int] | None) -> str:
    return NA if passed is None else f"{passed[0]}/{passed[1]}"


def contrast_rows(found: Ladder) -> Rows:
    return [
        [
            level_name(rung.value),
            f"{one.a} - {one.b}",
            str(one.difference.n),
            difference(one.difference),
            pvalue(one.p_holm),
        ]
        for rung in found.rungs
        for one in rung.contrasts
    ]


def factor_rows(found: Factors) -> Rows:
    rows: Rows = []
    for name in found.low:
        rows.append([name, "none", person_rate(found.low[name]), "", "", "", "", ""])
        rows += [
            [
                name, one.factor, person_rate(one.alone), difference(one.costs), pvalue(one.costs_p_holm),
                person_rate(one.without), difference(one.gives_back), pvalue(one.gives_back_p_holm),
            ]
            for one in found.effects
            if one.policy == name
        ]  # fmt: skip
        rows.append([name, "all", "", "", "", person_rate(found.high[name]), "", ""])
    return rows


def level_name(value: str) -> str:
    """Return a protocol as tables name it: a file by its stem."""
    return value.rsplit("/", 1)[-1].replace(".toml", "")


def person_rate(found: PersonRate | WorstShare) -> str:
    return NA if found.estimate is None else f"{100 * found.estimate:.0f} %{_bounds(found, '.0f')}"


def difference(found: PersonDifference | None) -> str:
    """In points."""
    if found is None or found.estimate is None:
        return NA
    return f"{100 * found.estimate:+.0f}{_bounds(found, '+.0f')}"


def _bounds(found: PersonRate | WorstShare | PersonDifference, shape: str) -> str:
    """Return an interval over persons in per cent; empty with too few of them."""
    if found.low is None or found.high is None or not enough(found.persons):
        return ""
    return f" [{100 * found.low:{shape}}, {100 * found.high:{shape}}]"


def pvalue(p: float | None) -> str:
    return NA if p is None else "< 0.0001" if p < 0.0001 else f"{p:.2g}" if p < 0.1 else f"{p:.2f}"


STEPS = {
    "gamma": "Safety gate, as a share of the pain onset",
    "region_correct": "Region-correct in place of safety-gated",
    "success": "Success in place of safety-gated",
}
"""What is no swept gate -> its name for people."""
SAME = "1.00"


def gate_titles(scores: Sequence[TrialScore]) -> dict[str, str]:
    """Gate -> its name for people, for the gates that apply to these trials."""
    found = dict(STEPS)
    for version in sorted({score.metric_versions.get("gates", "") for score in scores}):
        for name, (_, sweep) in sweeps_of(sorted({score.action for score in scores}), version).items():
            found[name] = sweep.title
    return found


def gate_rows(orders: Sequence[GateOrder], titles: Mapping[str, str]) -> list[list[str]]:
    """Return the smallest tau of each gate of ``titles``, place by place, with the value where it is. The gates that
    change no order anywhere share the last row."""
    places = dict.fromkeys(order.place for order in orders)
    cells = {(order.gate, order.place): _tau(order) for order in orders}
    gates = [gate for gate in dict.fromkeys(order.gate for order in orders) if gate in titles]
    rows = {gate: [cells.get((gate, place), NA) for place in places] for gate in gates}
    flat = [gate for gate in gates if set(rows[gate]) == {SAME}]
    found = [[f"{titles[gate]} ({gate})", *rows[gate]] for gate in gates if gate not in flat]
    if flat:
        names = "; ".join(titles[gate] for gate in flat)
        found.append([f"{'All others' if found else 'All'}: {names}", *([SAME] * len(places))])
    return found


def _tau(order: GateOrder) -> str:
    if order.least is None:
        return NA
    value = order.setting.partition(" ")[2]
    return SAME if order.least > 0.9999 else f"{order.least:.2f}" + (f" (at {value})" if value else "")


def as_csv(table: SweepTable) -> str:
    """Return one row for each cell; percentages are not rounded. Without trials its fields are empty, without all
    verdicts it has no percentages, and with fewer than SEEDS_FOR_INTERVAL seeds no intervals."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    metrics = headlines()
    left = ["policy", *table.axes, "folder", "planned"]
    right = ["trials", "crashed", "harness_errors"]
    right += [f"{name}{ending}" for name in RATES for ending in ("", "_pc", "_pc_low", "_pc_high")]
    right += [f"median_{metric.field or metric.id}" for metric in metrics]
    writer.writerow([*left, *right])
    for row in table.rows:
        cell, counts = row.cell, row.counts
        numbers: list[object] = [0 if counts is None else counts.n, row.crashed, row.harness_errors]
        if counts is not None:
            scores = judged(cell.scores)
            for name in RATES:
                field = "c3_success" if name == "success" else name
                found = share_passed(scores, field, unknown=counts.unknown)
                between = found["pc_ci95"] if counts.unknown or enough_seeds(scores) else ["", ""]
                numbers += [found["n"], "" if found["pc"] is None else found["pc"], *between]
            numbers += [counts.medians[metric.id].estimate for metric in metrics]
        numbers += [""] * (len(right) - len(numbers))
        writer.writerow([cell.label, *cell.values.values(), cell.folder, cell.planned, *numbers])
    return stream.getvalue()


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
        lines += [*_markdown(*axis_table(table)[1:]), ""]
    for title, head, rows in level_tables(table):
        lines += [f"## {title}", "", *_markdown(head, rows), ""]
    # The folder is the last column, because a copy of the table elsewhere does without it.
    rows = [[*cells(row), f"`{row.cell.folder}`"] for row in table.rows]
    lines += ["## Cells", "", *_markdown([*heads(table), "folder"], rows), ""]
    lines += ["## Provenance", "", *_markdown(HEADS, provenance(table)), ""]
    return "\n".join(lines)


def sentences(table: SweepTable) -> list[str]:
    """Return the sentences above the tables."""
    found = table.stability
    unfinished = {row.cell.label for row in table.rows if row.cell.unknown}
    others = [] if found is None else [
        named for name, named in table.named.items() if name not in found.passed and name not in unfinished
    ]  # fmt: skip
    text = render(
        "sweep-sentences.j2",
        table=table,
        done=sum(len(row.cell.scores) for row in table.rows),
        planned=sum(row.cell.planned for row in table.rows),
        failed=sum(row.harness_errors for row in table.rows),
        too_few="" if enough({s.seed for row in table.rows for s in row.cell.scores}) else TOO_FEW,
        found=found,
        order=_order(found) if found else "",
        passed=PASSED[table.rank_by],
        tau=sorted(found.taus) if found else [],
        others=others,
    )
    return [unescape(line) for line in text.splitlines() if line]


def _order(found: Stability) -> str:
    """``a (90 %) = b (90 %) > c (50 %)``"""
    parts: list[str] = []
    for before, name in pairwise([None, *found.passed]):
        if before is not None:
            parts.append("=" if found.passed[before] == found.passed[str(name)] else ">")
        parts.append(f"{name} ({percent(found.passed[str(name)] / found.n)})")
    return " ".join(parts)


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


def axis_table(table: SweepTable) -> Table:
    """Return how the order of the policies changes along each axis."""
    found = table.stability
    names = [name for name in table.policies if found is not None and name in found.passed]
    rows = [
        [row.axis, row.value, str(row.n), *(percent(row.passed[name] / row.n) for name in names),
         NA if row.tau is None else f"{row.tau:.2f}"]
        for row in (found.marginals if found is not None else ())
    ]  # fmt: skip
    return "Along each axis", ["axis", "value", "trials of each policy", *names, "tau with the overall order"], rows


def level_tables(table: SweepTable) -> list[Table]:
    """Return what the table has of draws, levels, factors and gates."""
    found: list[Table] = []
    metrics = headlines()
    if table.bands is not None:
        heads = ["policy", "task", "passed", *(metric.label for metric in metrics)]
        found.append(("Spread over the draws", heads, spread_rows(table.bands, table.named)))
        heads = ["policies", "task", "passed", *(metric.name for metric in metrics)]
        found.append(("Draws in which two policies change places", heads, flip_rows(table.bands)))
    if table.ladder is not None:
        found.append(("Success over level", LEVEL_HEADS, level_rows(table.ladder)))
        found.append(("By task", ["level", "policy", *table.ladder.tasks], task_rows(table.ladder)))
        found.append(("Methods against each other", CONTRAST_HEADS, contrast_rows(table.ladder)))
    if table.factors is not None:
        found.append(("One factor at a time", FACTOR_HEADS, factor_rows(table.factors)))
    titles = gate_titles([score for row in table.rows for score in row.cell.scores])
    heads = ["gate", *map(level_name, dict.fromkeys(order.place for order in table.gate_orders))]
    found.append(("The order under other gates", heads, gate_rows(table.gate_orders, titles)))
    return [one for one in found if one[2]]


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]] | map[list[str]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines]
