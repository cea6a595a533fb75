"""``carecontact compare``: runs side by side, without a simulator, as the terminal shows them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from carecontact.cli.groups import FLAT, JsonGroup, Switch
from carecontact.errors import ConfigError, counted

if TYPE_CHECKING:
    from carecontact.policies.registry import Role
    from carecontact.report.baselines import Baselines, Passed
    from carecontact.report.comparison import Comparison, RunInfo
    from carecontact.report.overview import Overview, PairOfRuns, Ranking
    from carecontact.report.paired import Line, Over, RateLine, ScoreLine
    from carecontact.runs.pooling import RunScores
    from carecontact.stats import RateDifference


# A comparison of two runs as the terminal shows it.

TESTS = ("paired", "Holm", "worst rank", "unpaired")
COLUMNS = ("", "A", "B", "A - B [95 %]", "pairs", *(f"p\n{test}" for test in TESTS), "verdict")
COMPARISON_WIDTH = 174
"""Least width of the terminal [columns] at which a table is printed."""


COMPARISON_ROLE_WORDS = {
    "privileged": "given the simulation: a ceiling, and no method",
    "blind": "a blind baseline, and no method",
    "probe": "a probe, and no method",
}
"""Role of a policy -> what is said of it; a method needs no word."""


def print_comparison(
    comparison: Comparison, a: Path, b: Path, *, crashed: Sequence[str] = ("", ""),
    roles: Sequence[Role] = ("method", "method"),
) -> None:  # fmt: skip
    """Print the comparison of two runs.

    Args:
        comparison: the comparison of the runs in ``a`` and ``b``.
        a: place of the run A.
        b: place of the run B.
        crashed: the trials in which the policy crashed, for A and for B; empty if there are none.
        roles: the roles of both policies.
    """
    from carecontact.protocol.lock import drifted_sha256
    from carecontact.protocol.protocol import protocol_title
    from carecontact.report.comparison import ALPHA
    from carecontact.report.paired import OVER_TEXTS
    from carecontact.report.words import TOO_FEW, enough

    pairing = comparison.pairing
    _say(f"{protocol_title(comparison.protocol_id, comparison.overrides)} ({comparison.protocol_sha256[:12]})")
    if not comparison.overrides and (why := drifted_sha256(comparison.protocol_id, comparison.protocol_sha256)):
        _say(f"protocol: {why}")
    for name, folder, info, alone, of_run, role in (
        ("A", a, comparison.a, pairing.unpaired_a, crashed[0], roles[0]),
        ("B", b, comparison.b, pairing.unpaired_b, crashed[1], roles[1]),
    ):
        remarks = "".join(f"; {remark}" for remark in (COMPARISON_ROLE_WORDS.get(role), of_run) if remark)
        _say(f"{name}: {_run_text(info, folder)}{remarks}{_alone_text(alone)}")
    tasks, seeds = counted(len(pairing.tasks), "task"), counted(len(pairing.seeds), "seed")
    _say(f"{counted(pairing.n, 'trial')} paired, {tasks}, {seeds}")
    for line in filter(None, (comparison.rejected_tissue, comparison.machines)):
        _say(line)
    heads = [_head("A", comparison.a), _head("B", comparison.b)]
    _print_lines(comparison.overall, heads)
    for task, lines in (comparison.per_task or {}).items():
        _say(f"\n{task}, {counted(lines[0].n_pairs, 'pair')}")
        _print_lines(lines, heads)
    if not enough(len(pairing.seeds)):
        _say(f"\n{TOO_FEW}; run more seeds")
    _say(f"\n{OVER_TEXTS[comparison.over]}")
    families = [f"{len(comparison.overall)} rows"]
    if comparison.per_task is not None:
        families.append(f"the {sum(map(len, comparison.per_task.values()))} rows of the tasks")
    _say(
        f"verdicts: a difference counts if its Holm-adjusted p-value is at most {ALPHA:g}; corrected over "
        f"{' and separately over '.join(families)}; see docs/statistics.md"
    )


def _say(text: str) -> None:
    """Print a text, wrapped between words on a narrow terminal and as one line elsewhere."""
    from carecontact.cli.console import console

    terminal = console(COMPARISON_WIDTH)
    terminal.print(text, soft_wrap=terminal.width >= COMPARISON_WIDTH)


def _run_text(info: RunInfo, folder: Path) -> str:
    counts = [counted(info.n_trials, "trial")]
    if info.n_planned > info.n_trials:
        counts = [f"incomplete, {info.n_trials} of {counted(info.n_planned, 'planned trial')} have a verdict"]
    return f"{info.policy} ({', '.join(info.language_backend)}), {folder}: {', '.join(counts)}"


def _alone_text(alone: dict[str, str]) -> str:
    if not alone:
        return ""
    why = ", ".join(f"{k} {reason}" for reason, k in sorted(Counter(alone.values()).items()))
    names = ", ".join(list(alone)[:6]) + (", ..." if len(alone) > 6 else "")
    return f"; {len(alone)} without a partner in the other run ({why}): {names}"


def _head(name: str, info: RunInfo) -> str:
    """Return the head of a run's column: ``A``, or ``A, 15 of 18 trials``."""
    return name if info.n_planned == info.n_trials else f"{name}, {info.n_trials} of\n{info.n_planned} trials"


def _print_lines(lines: Sequence[Line], heads: Sequence[str]) -> None:
    """``heads``: of the columns of A and B."""
    from rich.padding import Padding

    from carecontact.cli.console import console, plain_table
    from carecontact.report.paired import RateLine
    from carecontact.report.words import NOT_DEFINED

    terminal = console(COMPARISON_WIDTH)
    rows = [_rate_cells(line) if isinstance(line, RateLine) else _score_cells(line) for line in lines]
    words = [line.verdict.word if line.verdict else "" for line in lines]
    if terminal.width < COMPARISON_WIDTH:
        # A table that wraps inside its intervals cannot be read.
        for (name, a, b, difference, pairs, *pvalues), word in zip(rows, words, strict=True):
            tests = ", ".join(f"{p} {test}" for test, p in zip(TESTS, pvalues, strict=True) if p != NOT_DEFINED)
            counted = "1 pair" if pairs == "1" else f"{pairs} pairs"
            terminal.print(f"{name}: {word}")
            of_a, of_b = (f"{head.replace(chr(10), ' ')}:" if "," in head else head for head in heads)
            terminal.print(Padding(f"{of_a} {a}, {of_b} {b}, A - B {difference}, {counted}; p {tests}", (0, 0, 0, 2)))
    else:
        table = plain_table()
        for header in (COLUMNS[0], *heads, *COLUMNS[3:]):
            table.add_column(header, justify="left" if header in ("", "verdict") else "right")
        for cells, word in zip(rows, words, strict=True):
            table.add_row(*cells, word)
        terminal.print(table)
    for why, names in _reasons(lines).items():
        _say(f"{why}: {', '.join(names)}")


def _reasons(lines: Sequence[Line]) -> dict[str, list[str]]:
    """Return the reason of each verdict with its notes -> the lines for which it holds. Verdicts that explain
    themselves are left out."""
    from carecontact.report.paired import RateLine

    found: dict[str, list[str]] = {}
    for line in lines:
        if line.verdict is not None and (why := "; ".join([line.verdict.text, *line.notes])) != line.verdict.word:
            name = line.outcome.title if isinstance(line, RateLine) else line.outcome.id
            found.setdefault(why, []).append(name)
    return found


def _rate_cells(line: RateLine) -> list[str]:
    from carecontact.cli.console import p_text
    from carecontact.report.words import NOT_DEFINED, enough, number

    def rate(estimate: float | None, low: float, high: float) -> str:
        percent = None if estimate is None else 100 * estimate
        return number(percent, 1) + (f" [{100 * low:.1f}, {100 * high:.1f}]" if enough(line.n_seeds) else "")

    found = line.difference
    return [
        f"{line.outcome.title} [%]",
        *(f"{p.k}/{p.n}: {rate(p.estimate, p.low, p.high)}" for p in (line.a, line.b)),
        rate(found.estimate, found.low, found.high),
        str(line.n_pairs),
        p_text(line.test.pvalue),
        p_text(line.p_holm),
        NOT_DEFINED,
        p_text(line.unpaired.pvalue),
    ]


def _score_cells(line: ScoreLine) -> list[str]:
    from carecontact.cli.console import p_text
    from carecontact.report.paired import plain_text
    from carecontact.report.words import enough

    def shown(value: float | None) -> str:
        return plain_text(line.outcome, value)

    actions = "" if line.outcome.actions is None else f", {' and '.join(line.outcome.actions).capitalize()}"
    unit = "" if line.outcome.unit == "1" else f" [{line.outcome.unit}]"
    found = line.difference
    interval = "" if found.low is None or not enough(line.n_seeds) else f" [{shown(found.low)}, {shown(found.high)}]"
    return [
        f"{line.outcome.id}{unit}{actions}",
        *(f"{shown(m.estimate)}{f' (n={m.n_valid})' * (m.n_valid != m.n)}" for m in (line.a, line.b)),
        f"{shown(found.estimate)}{interval}",
        f"{found.n} of {line.n_pairs}" if found.n != line.n_pairs else str(found.n),
        p_text(line.test.pvalue),
        p_text(line.p_holm),
        p_text(line.worst_rank.pvalue),
        p_text(None if line.unpaired is None else line.unpaired.pvalue),
    ]


# What ``carecontact compare`` prints of more than two runs, and of baselines.

RATE_NAMES = {"success": "success", "region_correct": "region-correct", "safety_gated": "safety-gated"}
OVERVIEW_WIDTH = 140


def print_overview(overview: Overview, runs: Sequence[Path]) -> None:
    """Print the overview of several runs.

    Args:
        runs: places of the runs, in the order of the overview.
    """
    from carecontact.protocol.protocol import protocol_title

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
    from carecontact.report.tables import headlines
    from carecontact.report.words import TOO_FEW, enough

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
    console(OVERVIEW_WIDTH).print(table)
    if not enough(overview.seeds):
        print(TOO_FEW)


def _print_pairs(pairs: Sequence[PairOfRuns], over: Over) -> None:
    from carecontact.cli.console import console, p_text, plain_table
    from carecontact.report.comparison import ALPHA
    from carecontact.report.paired import OVER_TEXTS, RateLine

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
    console(OVERVIEW_WIDTH).print(table)
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
    console(OVERVIEW_WIDTH).print(table)
    print(
        "Kendall tau compares each ranking with that under the protocol's own gates: 1 is the same order, "
        "-1 the reverse order"
    )


OVERVIEW_ROLE_WORDS = {"privileged": " (ceiling)", "probe": " (probe)", "blind": " (blind)"}
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
    from carecontact.report.words import NOT_DEFINED

    rates = [
        row.count(name) if row.unknown else _interval(100 * p.k / p.n, 100 * p.low, 100 * p.high, seeds=row.seeds)
        for name, p in row.rates.items()
    ]
    above = NOT_DEFINED if row.above is None else _points(row.above["safety_gated"], row.above_seeds or 0)
    pairs = NOT_DEFINED if row.n_pairs is None else str(row.n_pairs)
    counts = [row.per_task.get(task, {}).get("safety_gated") for task in tasks]
    return [
        row.policy + OVERVIEW_ROLE_WORDS.get(row.role, ""), row.trials, *rates, above, pairs,
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
    from carecontact.report.words import enough, number

    return number(value, 1) + (f" [{low:.1f}, {high:.1f}]" if enough(seeds) else "")


# ``carecontact compare``: runs side by side, without a simulator.

COMPARISON, OVERVIEW = "comparison.json", "overview.json"


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare runs of one protocol. For two runs, compare trial by trial: which scores differ, and what is the smallest
    difference that these trials could detect. For more runs, compare success rates and every pair, and check whether
    the ranking stays the same with other gates. See docs/statistics.md."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN_A [RUN_B ...]")]
    """Folders of runs, or their results.json (also .json.gz) alone. Differences are A minus B."""
    baseline: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Runs of baselines, which should be blind: the output shows their success rates beside those of each run. With
    --baseline, a single run is enough."""
    per_task: Switch = False
    """For two runs: also print a table for each task. The p-values of these tables are corrected together, separately
    from the main table."""
    out: Path | None = None
    """Folder for comparison.json (two runs) and overview.json (three or more runs, or blind baselines); default: write
    neither file."""
    allow_incomplete: Switch = False
    """Also compare runs of which planned trials have no verdict, over the trials that there are, without a ranking."""
    rescore: Switch = False
    """Compute the scores again where a folder has recordings, in place of reading its results.json."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 0 whatever is found. Raises ConfigError if the runs cannot be compared."""
        self._check()
        scored = [self._read(path) for path in self.runs]
        baselines = [self._read(path) for path in self.baseline]
        comparison = self._compare_two(scored) if len(self.runs) == 2 else None
        found, beside = self._overview(scored, baselines) if len(self.runs) > 2 or baselines else (None, {})
        if self.output.json:
            _say_comparison(comparison, found, beside)
        return 0

    def _check(self) -> None:
        from carecontact.report.comparison import check_different

        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise ConfigError(f"--out {self.out}: this is a file; name a folder")
        check_different([*self.runs, *self.baseline])
        if len(self.runs) < 2 and not self.baseline:
            raise ConfigError(f"expected two or more runs, or one run and --baseline RUN..., got {len(self.runs)}")
        if self.per_task and len(self.runs) != 2:
            raise ConfigError(f"--per-task needs exactly two runs, got {len(self.runs)}")

    def _read(self, run: Path) -> RunScores:
        from carecontact.cli.groups import read_run
        from carecontact.report.comparison import check_complete

        scores = read_run(run, rescore=self.rescore)
        if not scores.scores and scores.skipped:
            why = next(iter(scores.skipped.values()))
            raise ConfigError(f"{run}: no recording could be scored; reason for the first one: {why}")
        if not self.allow_incomplete:
            check_complete(
                {str(run): scores}, otherwise=", or compare the trials that there are with --allow-incomplete"
            )
        return scores

    def _compare_two(self, scored: Sequence[RunScores]) -> Comparison:
        from carecontact.report.baselines import role_in
        from carecontact.report.comparison import compare_runs
        from carecontact.report.words import crashed_text

        comparison = compare_runs(*scored, per_task=self.per_task, allow_incomplete=True)
        print_comparison(
            comparison, *self.runs, crashed=[crashed_text(run.scores) for run in scored],
            roles=[role_in(run.scores) for run in scored],
        )  # fmt: skip
        if self.out is not None:
            print(f"comparison: {_write(comparison.as_json(), self.out / COMPARISON)}")
        return comparison

    def _overview(
        self, scored: Sequence[RunScores], baselines: Sequence[RunScores]
    ) -> tuple[Overview | None, dict[str, Baselines]]:
        from carecontact.report.baselines import beside_baselines
        from carecontact.report.overview import overview, overview_json

        named = list(zip(ascii_uppercase, scored, strict=False))
        beside = {letter: beside_baselines(run, baselines, allow_incomplete=True) for letter, run in named if baselines}
        found = overview(scored) if len(scored) > 2 else None
        if found is not None:
            print_overview(found, self.runs)
        for letter, of_run in beside.items():
            print_baselines(of_run, letter if len(scored) > 1 else "")
        # The comparison of two runs names theirs itself.
        runs = named if found else [("", run) for run in scored if len(scored) == 1]
        _print_crashed([*runs, *(("", run) for run in baselines)])
        if self.out is not None:
            print(f"overview: {_write(overview_json(found, beside), self.out / OVERVIEW)}")
        return found, beside


def _say_comparison(comparison: Comparison | None, found: Overview | None, beside: dict[str, Baselines]) -> None:
    from carecontact.cli.console import print_answer
    from carecontact.cli.result_answers import CompareAnswer
    from carecontact.report.comparison import ALPHA, POWER

    print_answer(CompareAnswer(alpha=ALPHA, power=POWER, comparison=comparison, overview=found, baselines=beside))


def _print_crashed(named: Sequence[tuple[str, RunScores]]) -> None:
    """Print in which trials the policies crashed.

    Args:
        named: pairs of a run's letter (empty for one run alone) and the run.
    """
    from carecontact.report.words import crashed_text

    for letter, run in named:
        if crashed := crashed_text(run.scores):
            policy = run.scores[0].policy_title
            print(f"{f'{letter} ({policy})' if letter else policy} {crashed}")


def _write(content: Mapping[str, Any], path: Path) -> Path:
    from carecontact.recording.file import replace_file

    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False)
    replace_file(path, f"{text}\n".encode("ascii"))
    return path
