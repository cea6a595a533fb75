"""Comparisons of runs, and baselines beside them, as the terminal shows them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.padding import Padding

from carecontact.cli.console import console, p_text, plain_table
from carecontact.errors import counted
from carecontact.protocol.lock import drifted_sha256
from carecontact.protocol.protocol import protocol_title
from carecontact.report.baselines import Baselines, Passed, role_in
from carecontact.report.comparison import ALPHA, Comparison, RunInfo
from carecontact.report.overview import Overview
from carecontact.report.paired import OVER_TEXTS, Line, Over, RateLine, ScoreLine, plain_text
from carecontact.report.tables import headlines
from carecontact.report.words import NOT_DEFINED, TOO_FEW, crashed_text, enough, number
from carecontact.runs.pooling import RunScores
from carecontact.stats import RateDifference

COMPARISON_WIDTH, OVERVIEW_WIDTH = 174, 140
"""Least width of the terminal [columns] at which a comparison is a table; width of the other tables elsewhere."""
NO_METHOD = {
    "privileged": "given the simulation: a ceiling, and no method",
    "blind": "a blind baseline, and no method",
    "probe": "a probe, and no method",
}
"""Role of a policy -> remark about it; a method needs none."""
SHORT_ROLES = {"privileged": " (ceiling)", "probe": " (probe)", "blind": " (blind)"}
"""Role of a policy -> words after its name in the table of baselines."""
RATES = ("success [95 %]", "region-\ncorrect [95 %]", "safety-\ngated [95 %]")
INTERVALS_OVER: dict[Over, str] = {
    "seeds": "over seeds (a seed is one person, whose trials are not independent)",
    "trials": "over trials, as if they were independent,",
}


def print_comparison(comparison: Comparison, places: Sequence[Path], runs: Sequence[RunScores]) -> None:
    pairing = comparison.pairing
    _print(f"{protocol_title(comparison.protocol_id, comparison.overrides)} ({comparison.protocol_sha256[:12]})")
    if not comparison.overrides and (why := drifted_sha256(comparison.protocol_id, comparison.protocol_sha256)):
        _print(f"protocol: {why}")
    infos, alone = (comparison.a, comparison.b), (pairing.unpaired_a, pairing.unpaired_b)
    for name, place, run, info, unpaired in zip("AB", places, runs, infos, alone, strict=True):
        counts = counted(info.n_trials, "trial")
        if info.n_planned > info.n_trials:
            counts = f"incomplete, {info.n_trials} of {counted(info.n_planned, 'planned trial')} have a verdict"
        remarks = (NO_METHOD.get(role_in(run.scores)), crashed_text(run.scores), _unpaired_text(unpaired))
        text = f"{info.policy} ({', '.join(info.language_backend)}), {place}: {counts}"
        _print(f"{name}: {'; '.join([text, *filter(None, remarks)])}")
    tasks, seeds = counted(len(pairing.tasks), "task"), counted(len(pairing.seeds), "seed")
    _print(f"{counted(pairing.n, 'trial')} paired, {tasks}, {seeds}")
    for line in filter(None, (comparison.rejected_tissue, comparison.machines)):
        _print(line)
    _print_lines(comparison.overall, infos)
    for task, lines in (comparison.per_task or {}).items():
        _print(f"\n{task}, {counted(lines[0].n_pairs, 'pair')}")
        _print_lines(lines, infos)
    if not enough(len(pairing.seeds)):
        _print(f"\n{TOO_FEW}; run more seeds")
    _print(f"\n{OVER_TEXTS[comparison.over]}")
    families = f"{len(comparison.overall)} rows"
    if comparison.per_task is not None:
        families += f" and separately over the {sum(map(len, comparison.per_task.values()))} rows of the tasks"
    _print(
        f"verdicts: a difference counts if its Holm-adjusted p-value is at most {ALPHA:g}; corrected over {families}; "
        "see docs/comparing.md"
    )


def _print(text: str) -> None:
    """Print a text, wrapped between words on a narrow terminal and as one line elsewhere."""
    terminal = console(COMPARISON_WIDTH)
    terminal.print(text, soft_wrap=terminal.width >= COMPARISON_WIDTH)


def _unpaired_text(alone: Mapping[str, str]) -> str:
    if not alone:
        return ""
    why = ", ".join(f"{k} {reason}" for reason, k in sorted(Counter(alone.values()).items()))
    names = ", ".join(list(alone)[:6]) + (", ..." if len(alone) > 6 else "")
    return f"{len(alone)} without a partner in the other run ({why}): {names}"


def _print_lines(lines: Sequence[Line], infos: Sequence[RunInfo]) -> None:
    """Print one row for each line, as a table where the terminal is wide enough."""
    heads = [
        name if info.n_planned == info.n_trials else f"{name}, {info.n_trials} of\n{info.n_planned} trials"
        for name, info in zip("AB", infos, strict=True)
    ]
    headers = ("", *heads, "A - B [95 %]", "pairs", "p\npaired", "p\nHolm", "p\nworst rank", "p\nunpaired", "verdict")
    terminal, table = console(COMPARISON_WIDTH), plain_table(*headers, left=("verdict",))
    reasons: dict[str, list[str]] = {}
    for line in lines:
        verdict = line.verdict
        word = "" if verdict is None else verdict.word
        name, *cells = _rate_cells(line) if isinstance(line, RateLine) else _score_cells(line)
        table.add_row(name, *cells, word)
        if terminal.width < COMPARISON_WIDTH:
            # A table that wraps inside its intervals cannot be read.
            shown = zip(headers[1:], cells, strict=False)
            text = ", ".join(f"{' '.join(head.split())} {cell}" for head, cell in shown if cell != NOT_DEFINED)
            terminal.print(f"{name}: {word}", Padding(text, (0, 0, 0, 2)), sep="\n")
        # A verdict without notes explains itself.
        if verdict is not None and (why := "; ".join([verdict.text, *line.notes])) != word:
            reasons.setdefault(why, []).append(line.outcome.title if isinstance(line, RateLine) else line.outcome.id)
    if terminal.width >= COMPARISON_WIDTH:
        terminal.print(table)
    for why, names in reasons.items():
        _print(f"{why}: {', '.join(names)}")


def _rate_cells(line: RateLine) -> list[str]:
    tests = (line.test.pvalue, line.p_holm, None, line.unpaired.pvalue)
    return [
        f"{line.outcome.title} [%]",
        *(f"{p.k}/{p.n}: {_interval(p.estimate, p.low, p.high, seeds=line.n_seeds)}" for p in (line.a, line.b)),
        _points(line.difference, line.n_seeds),
        str(line.n_pairs),
        *(NOT_DEFINED if number == 2 else p_text(value) for number, value in enumerate(tests)),
    ]


def _score_cells(line: ScoreLine) -> list[str]:
    def shown(value: float | None) -> str:
        return plain_text(line.outcome, value)

    actions = "" if line.outcome.actions is None else f", {' and '.join(line.outcome.actions).capitalize()}"
    unit = "" if line.outcome.unit == "1" else f" [{line.outcome.unit}]"
    found = line.difference
    interval = "" if found.low is None or not enough(line.n_seeds) else f" [{shown(found.low)}, {shown(found.high)}]"
    unpaired = None if line.unpaired is None else line.unpaired.pvalue
    return [
        f"{line.outcome.id}{unit}{actions}",
        *(f"{shown(m.estimate)}{f' (n={m.n_valid})' * (m.n_valid != m.n)}" for m in (line.a, line.b)),
        f"{shown(found.estimate)}{interval}",
        f"{found.n} of {line.n_pairs}" if found.n != line.n_pairs else str(found.n),
        *map(p_text, (line.test.pvalue, line.p_holm, line.worst_rank.pvalue, unpaired)),
    ]


def _points(found: RateDifference, seeds: int) -> str:
    return _interval(found.estimate, found.low, found.high, seeds=seeds)


def _interval(value: float | None, low: float, high: float, *, seeds: int) -> str:
    """A fraction or difference in percent; its interval, unless it rests on too few ``seeds``."""
    percent = number(None if value is None else 100 * value, 1)
    return percent + (f" [{100 * low:.1f}, {100 * high:.1f}]" if enough(seeds) else "")


def print_overview(overview: Overview, places: Sequence[Path]) -> None:
    print(f"{protocol_title(overview.protocol_id, overview.overrides)} ({overview.protocol_sha256[:12]})")
    for (letter, policy), place in zip(overview.policies.items(), places, strict=True):
        remarks = [overview.incomplete[letter]] if letter in overview.incomplete else []
        if left := overview.left_out[letter]:
            remarks.append(f"{counted(left, 'trial')} left out, because not every run has the same")
        print(": ".join([f"{letter}: {policy}, {place}", *remarks]))
    print(f"trials that all runs have: {overview.n}\n")
    heads = [metric.label for metric in headlines()]
    table, terminal = plain_table("", *RATES, *heads), console(OVERVIEW_WIDTH)
    for letter, row in overview.rows.items():
        rates = overview.rates[letter].values()
        cells = [_interval(p.k / p.n, p.low, p.high, seeds=overview.seeds) for p in rates]
        name = f"{letter} (incomplete)" if letter in overview.incomplete else letter
        table.add_row(name, *cells, *row.median_cells())
    terminal.print(table)
    if not enough(overview.seeds):
        print(TOO_FEW)
    _print_pairs(overview)
    for line in filter(None, (overview.rejected_tissue, overview.machines)):
        print(line)
    if overview.ranking is None:
        lacking = "; ".join(f"{letter} is {text}" for letter, text in overview.incomplete.items())
        print(f"\nnot ranked: {lacking}")
        return
    print(f"\nranking by safety-gated trials: {', '.join(' = '.join(group) for group in overview.ranking.order)}")
    table = plain_table("changed setting", "smallest Kendall tau", "at", left=("at",))
    for sweep, (least, level) in overview.ranking.least_by_sweep().items():
        table.add_row(sweep, "no ranking" if least is None else f"{least:.2f}", level)
    terminal.print(table)
    print(
        "Kendall tau compares each ranking with that under the protocol's own gates: 1 is the same order, "
        "-1 the reverse order"
    )


def _print_pairs(overview: Overview) -> None:
    test = "p McNemar" if overview.over == "trials" else "p over seeds"
    table = plain_table("", "difference [95 %]", "pairs", test, "p Holm", "verdict", left=("pairs", "verdict"))
    for pair in overview.pairs:
        for line in pair.lines:
            assert isinstance(line, RateLine)
            word = "" if line.verdict is None else line.verdict.word
            word = {"A higher": f"{pair.a} higher", "B higher": f"{pair.b} higher"}.get(word, word)
            name = f"{pair.a} - {pair.b}, {line.outcome.title.lower()} [points]"
            pvalues = (p_text(line.test.pvalue), p_text(line.p_holm))
            table.add_row(name, _points(line.difference, line.n_seeds), str(line.n_pairs), *pvalues, word)
    print()
    console(OVERVIEW_WIDTH).print(table)
    print(OVER_TEXTS[overview.over])
    lines = sum(len(pair.lines) for pair in overview.pairs)
    print(
        f"verdicts: a difference counts if its Holm-adjusted p-value over the {lines} rows is at most {ALPHA:g}; to "
        "compare scores as well, run compare with two runs only"
    )


def print_baselines(found: Baselines, letter: str) -> None:
    """Print the baselines beside a run. ``letter``: of the run among several; empty for one run alone."""
    name = f"{letter} ({found.method.policy})" if letter else found.method.policy
    if not letter:
        print(found.protocol)
    if found.only_blind:
        print(f"\nblind baselines beside {name}: how often policies pass that cannot do the task")
    else:
        print(f"\nbaselines beside {name}")
    if any(row.role == "privileged" for row in found.baselines):
        print("a privileged policy is given the simulation: its rate is the ceiling, and it is never ranked")
    rates = ("success", "region-correct", "safety-gated")
    table = plain_table("", "trials", *rates, f"{letter or 'method'} - baseline", "pairs", *found.tasks)
    for row in (found.method, *found.baselines):
        table.add_row(*_baseline_cells(row, found.tasks))
    console(OVERVIEW_WIDTH).print(table)
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
    rates = [
        row.count(name) if row.unknown else _interval(p.k / p.n, p.low, p.high, seeds=row.seeds)
        for name, p in row.rates.items()
    ]
    above = NOT_DEFINED if row.above is None else _points(row.above["safety_gated"], row.above_seeds or 0)
    pairs = NOT_DEFINED if row.n_pairs is None else str(row.n_pairs)
    counts = [row.per_task.get(task, {}).get("safety_gated") for task in tasks]
    gated = [NOT_DEFINED if count is None else f"{count[0]}/{count[1]}" for count in counts]
    return [row.policy + SHORT_ROLES.get(row.role, ""), row.trials, *rates, above, pairs, *gated]


def print_crashed(named: Mapping[str, RunScores], baselines: Sequence[RunScores]) -> None:
    """Print in which trials the policies crashed. ``named``: letter of a run (empty for one run alone) -> the run."""
    for letter, run in [*named.items(), *(("", run) for run in baselines)]:
        if crashed := crashed_text(run.scores):
            policy = run.scores[0].policy_title
            print(f"{f'{letter} ({policy})' if letter else policy} {crashed}")
