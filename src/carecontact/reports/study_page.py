"""A study as Markdown. Every number comes from the study or from the paper's data; none is typed here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from carecontact.reports.compare.outcomes import RATES, SCORES, Outcome, plain_text
from carecontact.reports.compare.paired_lines import Line, ScoreLine
from carecontact.reports.compare.verdicts import ALPHA, POWER, few_seeds
from carecontact.reports.paper import Paper, PaperMethod
from carecontact.reports.study import (
    PAIR,
    PRIMARY,
    PROPOSAL,
    STIFFNESS,
    TISSUE,
    Beside,
    Method,
    RunHead,
    Study,
    Sweep,
    condition_title,
)
from carecontact.reports.table import COLUMNS, NA, NOT_DEFINED, number
from carecontact.stats import Proportion

AUTHORED = ":authored"
NOTES = {
    "state-machine": "`state-machine`: the paper's language model stands behind `rules-v1` only in so far as the same "
    "prompt and options are given to written rules. Its depths and speeds were chosen on this scene, before the first "
    "full run ([state-machine](../state-machine.md)).",
    "voxposer": "`voxposer`: how long the end of a path is held is a number of ours and not of the method, and touches "
    "hang on it ([voxposer](../voxposer.md)).",
}
"""What a reader of the rates has to know of a method; numbers stand where they were measured."""
SWEEP_TITLE = {STIFFNESS: "Stiffness of the arm", TISSUE: "Tissue"}


def study_page(found: Study, paper: Paper, *, command: str, json_name: str) -> str:
    """The page of a study.

    Args:
        command: that made the page, for whoever makes it again.
        json_name: file beside it with everything unrounded.
    """
    parts = [
        f"# {found.protocol_id}: the evaluated methods beside the paper",
        f"Written by `{command}`; do not edit. Unrounded, with every test: [{json_name}]({json_name}). How to read the "
        "tests: [statistics](../statistics.md).",
        _runs(found),
        _beside_paper(found, paper),
        _pair(found),
        _proposal(found),
        _failures(found, paper),
        _tasks(found),
        _floors(found),
        _gates(found),
        *(_sweep(found, sweep) for sweep in found.sweeps),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def escaped(text: str) -> str:
    """Text that a policy, a language model or a folder's name supplied, as plain text of Markdown."""
    return re.sub(r"([\\`*_\[\]<>])", r"\\\1", text)


def label(method: Method) -> str:
    """Name with what stands in for the language model: every table says it."""
    short = {"authored" if AUTHORED in backend else backend for backend in method.head.language_backend}
    return f"{method.head.policy} ({', '.join(sorted(short))})" if short else method.head.policy


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    """GitHub-flavoured; the first ``left`` columns to the left, the others to the right."""
    lines = [header, ["---" if k < left else "---:" for k in range(len(header))], *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def _runs(found: Study) -> str:
    rows = [
        (h.policy, h.title, escaped(", ".join(h.language_backend)), f"{h.n} of {h.n_planned}", str(h.n_harness_errors),
         str(len(h.skipped)))
        for h in sorted(found.heads, key=lambda h: (h.title, h.policy))
    ]  # fmt: skip
    world = ", ".join(f"{what} {value[:12]}" for what, value in found.world.items())
    parts = [
        "## Runs",
        f"Protocol {found.protocol_id} ({found.protocol_sha256[:12]}); {world}; carecontact {_versions(found.heads)}.",
        table(("policy", "protocol", "language", "trials", "harness failed", "unreadable"), rows, left=3),
    ]
    if any(AUTHORED in backend for h in found.heads for backend in h.language_backend):
        parts.append(
            "`authored`: the programs were written by hand, not by a language model. Such rows show what the method's "
            "machinery does with competent programs; no claim about language models rests on them."
        )
    if any(h.n < h.n_planned for h in found.heads):
        parts.append("**Not every trial of the protocol was run.** Figures below are over those that were.")
    parts.append("These commands make the runs:")
    parts.append("\n".join(f"    {command}" for command in found.commands))
    if found.missing:
        parts.append("**Missing**, and left out of every table; these commands make them:")
        parts.append("\n".join(f"    {command}" for command in found.missing))
    parts += [f"Not used: {escaped(name)}: {escaped(why)}." for name, why in found.unused.items()]
    return "\n\n".join(parts)


def _versions(heads: Sequence[RunHead]) -> str:
    return ", ".join(sorted({v for h in heads for v in h.versions.get("carecontact", [])})) or "of unknown version"


def _beside_paper(found: Study, paper: Paper) -> str:
    header = ("method", "from", "n", *(f"{r.title} [%]" for r in RATES), *map(_score_title, SCORES))
    rows: list[Sequence[str]] = []
    for name in dict.fromkeys((*found.methods, *paper.methods)):
        theirs, ours = paper.methods.get(name), found.methods.get(name)
        if theirs is not None:
            rows.append((theirs.title, "paper", str(paper.runs_per_method), *_paper_cells(theirs)))
        if ours is not None:
            rows.append((escaped(label(ours)), "here", str(ours.head.n), *_cells(ours)))
        else:
            rows.append((name, "here: not run", *[""] * (len(header) - 2)))
    return "\n\n".join(
        [
            "## Beside the paper",
            "Rates with 95 % intervals (Wilson). Medians over the trials that have the score; C2 on Push. The paper's "
            "person, robot cell, perception and programs are not these: rows stand beside each other, they are not "
            "tested against each other. Paper: tables `tab:wilson_rates`, `tab:policy_results`.",
            table(header, rows, left=2),
            *(note for name, note in NOTES.items() if name in found.methods),
        ]
    )


def _score_title(outcome: Outcome) -> str:
    return outcome.id if outcome.unit == "1" else f"{outcome.id} [{outcome.unit}]"


def _paper_cells(method: PaperMethod) -> list[str]:
    rates = [_percent(*method.rates[r.id]) for r in RATES]
    return [*rates, *(plain_text(s, method.medians[s.id]) for s in SCORES)]


def _cells(method: Method) -> list[str]:
    row = method.summary[-1]
    medians = [row.c1_n, row.c2_rad, row.c4, row.c5_n]
    cells = [
        plain_text(outcome, m.estimate) + (f" (n={m.n_valid})" if m.estimate is not None and m.n_valid != row.n else "")
        for outcome, m in zip(SCORES, medians, strict=True)
    ]
    return [*(_proportion(method.rates[r.id]) for r in RATES), *cells]


def _proportion(found: Proportion) -> str:
    return NA if found.estimate is None else _percent(found.estimate, found.low, found.high)


def _percent(estimate: float, low: float, high: float) -> str:
    return f"{100 * estimate:.1f} ({100 * low:.1f}, {100 * high:.1f})"


def _pair(found: Study) -> str:
    a, b = PAIR
    head = f"## {a} against {b}"
    if found.comparison is None:
        return f"{head}\n\nNot compared: a run of {a} or {b} is missing."
    pairing = found.comparison.pairing
    labels = [escaped(label(found.methods[name])) for name in PAIR]
    header = ("", *labels, "difference [95 %]", "pairs", "p", "p Holm", "detectable", "paper", "p (paper)",
              "unpaired p", "the difference is")  # fmt: skip
    family = len(found.comparison.overall)
    parts = [
        head,
        f"{pairing.n} pairs of trials with the same task and seed ({_count(len(pairing.tasks), 'task')}, "
        f"{_count(len(pairing.seeds), 'seed')}). Differences are {a} minus {b}; McNemar and Wilcoxon signed-rank, Holm "
        f"over the {family} lines of this comparison. Detectable: the smallest difference that this run would have "
        f"found with {POWER:.0%} power. Paper and unpaired: its values and its kinds of test (Fisher, Mann-Whitney; "
        "`tab:cross_tests`).",
        table(header, map(_beside_row, found.beside)),
        "\n".join(f"- {_told(row)}" for row in found.beside),
    ]
    alone = len(pairing.unpaired_a) + len(pairing.unpaired_b)
    if alone:
        parts.append(f"{_count(alone, 'trial')} without a partner; the JSON names them.")
    return "\n\n".join(parts)


def _proposal(found: Study) -> str:
    if found.proposal is None:
        return ""
    labels = [escaped(label(found.methods[name])) for name in PROPOSAL]
    header = ("", *labels, "difference [95 %]", "pairs", "p", "p Holm", "detectable")
    return "\n\n".join(
        [
            f"## {PROPOSAL[0]} against {PROPOSAL[1]}",
            "What the paper proposes, an objective of progress that takes over at the touch, against the method that "
            "it would change. The paper has no run of it. As above, with all lines of the comparison.",
            table(header, map(_line_cells, found.proposal.overall)),
            *_equal_pairs(found.proposal.overall),
        ]
    )


def _equal_pairs(lines: Sequence[Line]) -> list[str]:
    """Where so many pairs are equal that the median difference is 0 whatever the others say."""
    return [
        f"{line.outcome.title}: {line.test.n - line.test.n_unequal} of {line.test.n} pairs are equal, so that the "
        "median difference stands still, and with it what could be detected; the test is over the others."
        for line in lines
        if isinstance(line, ScoreLine) and line.test.n_unequal and line.difference.standard_error == 0
    ]


def _line_cells(line: Line) -> list[str]:
    outcome = line.outcome
    interval = _interval(line)
    unit = "" if outcome.unit == "1" else f" [{outcome.unit}]"
    return [
        f"{outcome.title}{unit}", plain_text(outcome, line.a.estimate), plain_text(outcome, line.b.estimate),
        f"{plain_text(outcome, line.difference.estimate)}{interval}", str(_pairs(line)),
        _p(line.test.pvalue), _p(line.p_holm), _detectable(line),
    ]  # fmt: skip


def _beside_row(row: Beside) -> list[str]:
    outcome, line = row.outcome, row.line
    return [
        *_line_cells(line), f"{plain_text(outcome, row.paper_a)} and {plain_text(outcome, row.paper_b)}",
        "not tested" if row.paper_test is None else _p(row.paper_test[1]),
        _p(None if line.unpaired is None else line.unpaired.pvalue), row.agreement,
    ]  # fmt: skip


def _interval(line: Line) -> str:
    low, high = line.difference.low, line.difference.high
    if low is None or high is None:
        return ""
    return f" [{plain_text(line.outcome, low)}, {plain_text(line.outcome, high)}]"


def _pairs(line: Line) -> int:
    return line.difference.n if isinstance(line, ScoreLine) else line.n_pairs


def _detectable(line: Line) -> str:
    if line.detectable is None:
        return "too few seeds to tell" if few_seeds(line) else "not to be told"
    return "none" if line.detectable.difference is None else plain_text(line.outcome, line.detectable.difference)


def _told(row: Beside) -> str:
    assert row.line.verdict is not None
    notes = "".join(f"; {note}" for note in row.line.notes)
    text = row.line.verdict.text
    for letter, name in zip("AB", PAIR, strict=True):
        text, notes = text.replace(f"{letter} higher", f"{name} higher"), notes.replace(f" {letter} is", f" {name} is")
    return f"{row.outcome.title}: {text}{notes}. {row.agreement.capitalize()}."


def _failures(found: Study, paper: Paper) -> str:
    parts = ["## Why trials failed"]
    for name, method in found.methods.items():
        theirs = paper.methods.get(name)
        parts.append(f"### {escaped(label(method))}")
        rows = [(m["mode"], m["attribution"], m["meaning"], str(m["count"])) for m in method.modes]
        failed = sum(int(m["count"]) for m in method.modes)
        parts.append(f"{failed} of {method.head.n} trials are not region-correct." + _paper_failures(theirs))
        if rows:
            parts.append(table(("mode", "attributed to", "meaning", "trials"), rows, left=3))
        parts += [
            f"{escaped(cause.name.capitalize())} ({cause.count}). "
            + " ".join(f"{trial}: {escaped(_sentence(text))}" for trial, text in cause.examples)
            for cause in method.causes
        ]
        parts.append(_anatomy(method, theirs))
    return "\n\n".join(parts)


def _paper_failures(method: PaperMethod | None) -> str:
    if method is None:
        return " The paper has no such method."
    n = sum(counts["n"] for counts in method.anatomy.values())
    mode = "" if method.dominant is None else f", {method.dominant[1]} of them {method.dominant[0].replace('_', ' ')}"
    return f" Paper: {method.failed} of {n}{mode}."


def _anatomy(method: Method, theirs: PaperMethod | None) -> str:
    rows = []
    for row in method.anatomy:
        counts = None if theirs is None else theirs.anatomy.get(row.region.replace(" ", "_"))
        there = [NOT_DEFINED] * 4
        if counts is not None:
            there = [f"{counts[key]}/{counts['n']}" for key in ("target", "off_target", "none", "success")]
        here = [f"{k}/{row.n}" for k in (row.target, row.off_target, row.none, row.success)]
        rows.append((row.region, *(f"{h} ({t})" for h, t in zip(here, there, strict=True)), str(row.process_failure)))
    return table(("where contact fell (paper)", "target", "off target", "none", "success", "process failed"), rows)


def _tasks(found: Study) -> str:
    parts = ["## Task by task"]
    for method in found.methods.values():
        parts += [f"### {escaped(label(method))}", table(COLUMNS, (row.cells() for row in method.summary), left=2)]
    return "\n\n".join(parts)


def _floors(found: Study) -> str:
    if not found.floors:
        return "## Null arms\n\nNo null arm was run: nobody can tell what the gates give away."
    any_of = next(iter(found.floors.values()))
    arms = [(f.policy, str(f.n), *(_proportion(f.rates[r.id]) for r in RATES)) for f in any_of.nulls]
    above = [
        (escaped(label(found.methods[name])), f.policy, str(f.n_pairs), *(_above(f.above, r.id) for r in RATES))
        for name, floors in found.floors.items()
        for f in floors.nulls
    ]
    titles = [r.title for r in RATES]
    return "\n\n".join(
        [
            "## Null arms",
            "What arms that cannot do a task pass all the same, in percent; below, method minus arm in points.",
            table(("arm", "n", *titles), arms),
            table(("method", "arm", "pairs", *titles), above, left=2),
        ]
    )


def _above(above: object, rate: str) -> str:
    found = above[rate] if isinstance(above, dict) else None
    if found is None or found.estimate is None:
        return NA
    return f"{100 * found.estimate:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"


def _gates(found: Study) -> str:
    if found.overview is None:
        return ""
    names = found.overview.policies
    order = ", then ".join(" = ".join(names[letter] for letter in group) for group in found.overview.ranking.order)
    rows = [(sweep, number(tau, 2), level) for sweep, (tau, level) in found.overview.ranking.least_by_sweep().items()]
    return "\n\n".join(
        [
            "## Does the ranking hang on a gate?",
            f"By safety-gated trials: {order}, over the {found.overview.n} trials that all of them have. Kendall's "
            "tau-b of the order under every other gate (1 the same, -1 the reverse), the smallest of each sweep:",
            table(("sweep", "smallest tau", "at"), rows),
        ]
    )


def _sweep(found: Study, sweep: Sweep) -> str:
    a, b = (_labelled(found, name) for name in PAIR)
    outcomes = [o for o in (*RATES, *SCORES) if o.id in PRIMARY]
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
    interval = _interval(line)
    decided = line.p_holm is not None and line.p_holm <= ALPHA
    return (
        f"{plain_text(outcome, line.a.estimate)} | {plain_text(outcome, line.b.estimate)}; "
        f"{plain_text(outcome, line.difference.estimate)}{interval}{'*' * decided}"
    )


def _tau(sweep: Sweep, outcome: Outcome, value: str) -> str:
    return number(sweep.ranking[outcome.id].tau[value].tau, 0) if sweep.ranking else NA


def _p(value: float | None) -> str:
    return NA if value is None else f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"
