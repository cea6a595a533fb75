"""The two methods under other conditions than the protocol's."""

from __future__ import annotations

from tools.study.page.lines import interval_text
from tools.study.page.markdown import escaped, label, table
from tools.study.plan import PAIR, PRIMARY, STIFFNESS, TISSUE, condition_title
from tools.study.study import Study
from tools.study.sweep import Sweep

from carecontact.reports.compare.outcomes import RATES, Outcome, plain_text, score_outcomes
from carecontact.reports.compare.paired_lines import Line
from carecontact.reports.compare.verdicts import ALPHA
from carecontact.reports.text import NA, number

SWEEP_TITLE = {STIFFNESS: "Stiffness of the arm", TISSUE: "Tissue"}


def sweep(found: Study, sweep: Sweep) -> str:
    a, b = (_labelled(found, name) for name in PAIR)
    outcomes = [o for o in (*RATES, *score_outcomes()) if o.id in PRIMARY]
    rows = []
    for level in sweep.levels:
        title = condition_title(sweep.field, level.value) + " (the protocol's)" * level.is_protocol
        if level.comparison is None:
            rows.append((title, "run missing", *[""] * len(outcomes)))
            continue
        lines = {line.outcome.id: line for line in level.comparison.overall}
        rows.append((title, str(level.comparison.pairing.n), *(_sweep_cell(lines[o.id]) for o in outcomes)))
    taus = [
        (condition_title(sweep.field, level.value), *(_tau(sweep, o, level.value) for o in outcomes))
        for level in sweep.levels
        if level.comparison is not None and not level.is_protocol
    ]
    header = [f"{o.title} [{o.unit}]" if o.unit != "1" else o.title for o in outcomes]
    parts = [
        f"## {SWEEP_TITLE[sweep.field]}",
        f"Cells: {a} | {b}, then the paired difference with its 95 % interval; * marks p Holm at most {ALPHA:g} within "
        "that condition's own comparison.",
        table(("", "pairs", *header), rows),
    ]
    if taus:
        parts += [
            "Order of the two methods against that under the protocol (tau-b: 1 the same, -1 the reverse; NA where two "
            "values are equal). With two methods this is the sign of the difference and no more.",
            table(("", *(o.title for o in outcomes)), taus),
        ]
    elif not sweep.ranking:
        parts.append("No ranking: the runs under the protocol's own value are missing.")
    parts += ["Safety-gated trials by task:", _by_task(found, sweep)]
    return "\n\n".join(parts)


def _labelled(found: Study, name: str) -> str:
    return escaped(label(found.methods[name])) if name in found.methods else name


def _by_task(found: Study, sweep: Sweep) -> str:
    tasks = sorted({task for level in sweep.levels for of_task in level.gated.values() for task in of_task})
    rows = [
        (condition_title(sweep.field, level.value), _labelled(found, name),
         *("/".join(map(str, of_task[task])) if task in of_task else NA for task in tasks))
        for level in sweep.levels
        for name, of_task in level.gated.items()
    ]  # fmt: skip
    return table(("", "method", *tasks), rows, left=2)


def _sweep_cell(line: Line) -> str:
    outcome = line.outcome
    interval = interval_text(line)
    decided = line.p_holm is not None and line.p_holm <= ALPHA
    return (
        f"{plain_text(outcome, line.a.estimate)} | {plain_text(outcome, line.b.estimate)}; "
        f"{plain_text(outcome, line.difference.estimate)}{interval}{'*' * decided}"
    )


def _tau(sweep: Sweep, outcome: Outcome, value: str) -> str:
    return number(sweep.ranking[outcome.id].tau[value].tau, 0) if sweep.ranking else NA
