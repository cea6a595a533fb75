"""The paper's tables and figures from any runs, beside its published values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path

from carecontact.errors import counted
from carecontact.protocol.gates import Gates
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.recording.file import replace_file
from carecontact.recording.schema import Recording
from carecontact.report import paper_figures
from carecontact.report.comparison import check_comparable
from carecontact.report.paired import RATES
from carecontact.report.paper_figures import NO_DATE, write_figure
from carecontact.report.paper_method import ABSENT, Method, Paper, Table, methods_of, read_paper
from carecontact.report.words import enough_seeds, listed
from carecontact.runs.pooling import SEEDS_FOR_INTERVAL, RunScores, rejected_text
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.result import TrialScore
from carecontact.stats import fisher_exact, mann_whitney, median, wilson_interval

REPEATS = "bathing-v3"
"""The protocol with the paper's rules, as far as the paper states them."""
PAPER_TRIALS, PAPER_TASKS = 140, 7
"""Trials of each of the paper's methods, and tasks."""
PARTS = {
    "gates": "gates", "limits": "force limits", "person": "the person", "variation": "what the seed draws",
    "scene": "the scene", "tasks": "tasks", "phases": "the phases of a trial", "physics": "physics",
    "impedance": "the robot's stiffness",
}  # fmt: skip
"""Section of a protocol -> its name for people."""


def other_rules(methods: Sequence[Method], protocol: Protocol | None) -> str | None:
    """Return a note for tables with the paper's values; None where the runs have its rules and as many trials. Of an
    unknown protocol (None), the name decides."""
    first = next((score for method in methods for score in method.scores), None)
    if first is None:
        return None
    if protocol is None:
        same = first.protocol_id == REPEATS and not first.overrides
        differs = None if same else "which is not the paper's"
    else:
        paper = load_protocol(REPEATS)
        parts = [name for part, name in PARTS.items() if getattr(protocol, part) != getattr(paper, part)]
        differs = f"which differs from {REPEATS}, the one with the paper's rules, in {listed(parts)}" if parts else None
    notes = [f"These runs are of {first.protocol_title}, {differs}: the paper's values are of other trials."]
    fewest = min((method.scores for method in methods if method.scores), key=len)
    if len(fewest) < PAPER_TRIALS:
        tasks = len({score.task_id for score in fewest})
        notes.append(
            f"A run here has {counted(len(fewest), 'trial')} of {tasks} of the {PAPER_TASKS} tasks: the paper's values "
            f"are over {PAPER_TRIALS} trials of all tasks."
        )
    return " ".join(notes[differs is None :]) or None


KINDS = {"target": "Target", "off_target": "Off-target", "none": "No contact"}
ANATOMY_NUMBERS = (
    "region", "method", "trials", *KINDS, "success", "process_failures", "paper_trials",
    *(f"paper_{kind}" for kind in KINDS), "paper_success",
)  # fmt: skip


def anatomy(methods: Sequence[Method], *, note: str | None = None) -> Table:
    every = sorted((score for method in methods for score in method.scores), key=lambda score: score.task_id)
    regions = list(dict.fromkeys(score.region for score in every))
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[object, ...]] = []
    for region in regions:
        for method in methods:
            of_region = [score for score in method.scores if score.region == region]
            counts = {kind: sum(score.anatomy == kind for score in of_region) for kind in (*KINDS, "process_failure")}
            counts["success"] = sum(score.c3_success for score in of_region)
            printed = (method.published.anatomy.get(region) if method.published else None) or {}
            n = len(of_region)
            cells = [
                text
                for key in (*KINDS, "success")
                for text in (f"{counts[key]}/{n}", f"{printed[key]}/{printed['n']}" if printed else ABSENT)
            ]
            rows.append((region.replace("_", " ").capitalize(), method.title, *cells, str(counts["process_failure"])))
            ours = [counts[key] for key in (*KINDS, "success", "process_failure")]
            theirs = [printed.get(key) for key in ("n", *KINDS, "success")]
            numbers.append((region, method.title, n, *ours, *theirs))
    head = [text for title in (*KINDS.values(), "C3") for text in (title, f"Paper: {title}")]
    return Table(
        name="anatomy",
        caption="Where contact was made, and success, by region",
        head=("Region", "Method", *head, "Process failures"),
        rows=tuple(rows),
        notes=("Process failures make up for what is missing to the number of trials.", *filter(None, [note])),
        numbers=(ANATOMY_NUMBERS, *numbers),
    )


PAIR = ("state-machine", "voxposer")
"""The methods that the paper tests against each other."""


def contrasts(methods: Sequence[Method], paper: Paper, *, note: str | None = None) -> Table | None:
    """Return the tests between the paper's two methods, or else the first two; None with only one method."""
    if len(methods) < 2:
        return None
    by_policy = {method.policy: method for method in reversed(methods)}
    as_printed = all(policy in by_policy for policy in PAIR)
    a, b = (by_policy[policy] for policy in PAIR) if as_printed else methods[:2]
    rows: list[tuple[str, ...]] = []
    outcomes = {outcome.id: outcome for outcome in (*RATES, *paper.scores())}
    for id_, (test, printed) in paper.pvalues.items():
        outcome = outcomes[id_]
        values = [[outcome.of(s) for s in method.scores if outcome.counts(s)] for method in (a, b)]
        rows.append((outcome.title, test, _p(test, *values), f"{printed:.2e}" if as_printed else ABSENT))
    return Table(
        name="tests",
        caption=f"{a.title} against {b.title}, unpaired",
        head=("Outcome", "Test", "p", "Paper: p"),
        rows=tuple(rows),
        notes=(
            "Rates use all trials, scores those that have them. `carecontact compare` pairs the trials by their seeds, "
            "which needs fewer of them.",
            *filter(None, [note if as_printed else None]),
        ),
    )


def _p(test: str, first: Sequence[float | None], second: Sequence[float | None]) -> str:
    if test == "Fisher exact":
        found = fisher_exact(sum(map(bool, first)), len(first), sum(map(bool, second)), len(second)).pvalue
        return f"{found:.2e}"
    a, b = ([value for value in values if value is not None] for values in (first, second))
    return f"{mann_whitney(a, b).pvalue:.2e}" if a and b else ABSENT


CAPABILITIES = (
    "Deformable human", "Passive joints", "Force calibration", "Leak-free observation", "Physics-aware scoring",
)  # fmt: skip


def capability(paper: Paper) -> Table:
    return Table(
        name="capability",
        caption="Capabilities of benchmarks, as the paper judges them",
        head=("System", *CAPABILITIES),
        rows=tuple((system, *marks) for system, marks in paper.capability.items()),
        notes=("All cells are the paper's; nothing here was measured.",),
    )


def tasks(protocol: Protocol, paper: Paper, methods: Sequence[Method]) -> Table:
    """``methods``: they tell which of the protocol's tasks ran."""
    ran = {score.task_id for method in methods for score in method.scores}
    rows: list[tuple[str, ...]] = []
    for task in protocol.tasks:
        name = task.name if task.id in ran else f"{task.name} (not run)"
        rows.append((task.id, name, protocol.task(task.id).prompt, *paper.tasks.get(task.id, [ABSENT, ABSENT])))
    head = ("ID", "Task", "Prompt", "Paper: task", "Paper: purpose")
    return Table(name="tasks", caption=f"Tasks of {protocol.title}", head=head, rows=tuple(rows))


def metrics(paper: Paper) -> Table:
    rows: list[tuple[str, ...]] = []
    for id_, metric in METRICS.items():
        if metric.name in paper.metrics:
            direction = {"higher": "higher", "lower": "lower", "neither": ABSENT}[metric.better]
            unit = ABSENT if metric.unit == "1" else metric.unit
            rows.append((metric.name, metric.title, unit, direction, id_, *paper.metrics[metric.name]))
    return Table(
        name="metrics",
        caption="Scores",
        head=("Score", "What it is", "Unit", "Better", "Definition", "Paper: layer", "Paper: score"),
        rows=tuple(rows),
        notes=("docs/scores.md defines each.",),
    )


UNITS = {"s": "s", "n": "N", "m": "m"}
"""End of a field's name -> unit."""


def protocol_table(protocol: Protocol, paper: Paper, methods: Sequence[Method]) -> Table:
    """Return the table of the protocol. Counts are those of the trials of ``methods``, beside those that the protocol
    plans."""
    gates, limits = protocol.gates, protocol.limits
    places = "the seed draws their places" if protocol.variation.draws_models else "one person"
    drawn = "" if protocol.variation.tissue == "declared" else ", with a stiffness drawn by the seed"
    trials = {frozenset((s.task_id, s.seed) for s in method.scores) for method in methods}
    same = "the same of every task for all methods" if len(trials) == 1 else "not the same for all methods"
    ours = {
        "Assets": f"one bed and robot for all methods; {places}",
        "Person": _person(protocol),
        "Tissue": f"{protocol.person.tissue_set}{drawn}",
        "Comfort-arm angle": "{:g} to {:g} deg".format(*protocol.randomization.comfort_arm_deg),
        "Seeds": same,
        **_counts(protocol, methods),
        "Success gates": _gates(gates),
        **{f"Pain onset, {name.replace('_', ' ')}": f"{value:g} N" for name, value in limits.f_pain_n.items()},
        "Safety gate": f"{limits.gamma:g} of the pain onset",
        "Joint envelopes": _joints(gates.joint_beyond_rad),
        "Logger schema": "policy: RGB, depth, points, masks and encoders, as it asks; scorer alone: forces, joints and "
        "poses at every physics step",
        "Replay": "scores are computed from the recording alone, at any time again",
        "Without valid contact": "C1, C2 and C5 are NA, C3 is 0",
        "Time limit": f"{protocol.phases.time_limit_s:g} s",
        "Physics step": f"{1000 * protocol.physics.dt_s:g} ms",
        "Hash of the protocol": protocol.sha256[:12],
    }
    return Table(
        name="protocol",
        caption=f"Protocol {protocol.title}",
        head=("Item", "Ours", "Paper"),
        rows=tuple((item, text, paper.protocol.get(item, ABSENT)) for item, text in ours.items()),
    )


def _counts(protocol: Protocol, methods: Sequence[Method]) -> dict[str, str]:
    """Return what ran, of what the protocol plans."""
    seeds, tasks = len(protocol.randomization.seeds), len(protocol.tasks)
    ran = [[score.task_id for score in method.scores] for method in methods]
    return {
        "Initialisations": f"{_of(_range(ids.count(task) for ids in ran for task in set(ids)), seeds)} a task",
        "Tasks": _of(_range(len(set(ids)) for ids in ran), tasks),
        "Runs a method": _of(_range(map(len, ran)), seeds * tasks),
    }


def _of(ran: str, planned: int) -> str:
    return ran if ran == str(planned) else f"{ran} of {planned} planned"


def _range(counts: Iterable[int]) -> str:
    """``6``, or ``6 to 9`` where methods or tasks differ."""
    found = sorted(set(counts))
    return " to ".join(map(str, dict.fromkeys((found[0], found[-1])))) if found else "0"


def _person(protocol: Protocol) -> str:
    bodies = protocol.variation.bodies
    body = f"{len(bodies)} bodies, drawn by the seed" if bodies else protocol.person.body
    alive = protocol.person.alive
    moves = {"breathes": alive.breathing, "changes posture": alive.repositioning, "draws back": alive.withdrawal}
    does = [word for word, value in moves.items() if value is not None]
    does += [alive.manner] if alive.manner != "passive" else []
    return f"{body}; {listed(does)}" if does else body


def _gates(gates: Gates) -> str:
    """Their numbers, named as in the protocol's file: ``paper: touch duration 0.5 s; ...``."""
    actions = [
        f"{action} " + ", ".join(_amount(name, value) for name, value in table.model_dump().items())
        for action, table in (*gates.actions.items(), *([("foam", gates.foam)] if gates.foam else []))
    ]
    return f"{gates.set}: {'; '.join(actions)}"


def _amount(field: str, value: float) -> str:
    name, _, unit = field.rpartition("_")
    text = f"{name} {value:g} {UNITS[unit]}" if unit in UNITS else f"{field} {value:g}"
    return text.replace("_", " ")


def _joints(beyond_rad: float | None) -> str:
    if beyond_rad is None:
        return "C2 scores them; no gate"
    return f"at most {math.degrees(beyond_rad):.1f} deg beyond a range, else not safety-gated"


Rate = tuple[float, float | None, float | None]
"""A rate in percent, and its interval where there is one."""
RATES_NUMBERS = (
    "method", "rate", "passed", "trials", "percent", "percent_low", "percent_high", "paper_percent",
    "paper_percent_low", "paper_percent_high",
)  # fmt: skip


def rates(methods: Sequence[Method], *, note: str | None = None) -> Table:
    """``note``: why the rates must not be set beside the paper's as they are."""
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[object, ...]] = []
    for method in methods:
        cells: list[str] = []
        for rate in RATES:
            n = len(method.scores)
            k = sum(bool(rate.of(score)) for score in method.scores)
            found = wilson_interval(k, n)
            interval = (found.low, found.high) if enough_seeds(method.scores) else (None, None)
            ours = _in_percent(k / n, *interval)
            printed = method.published and _in_percent(*method.published.rates[rate.id])
            cells += [f"{k}/{n}", _shown(ours), _shown(printed) if printed else ABSENT]
            numbers.append((method.title, rate.id, k, n, *ours, *(printed or (None, None, None))))
        rows.append((method.title, *cells))
    head = [text for r in RATES for text in (f"{r.title}, n", f"{r.title} [%]", f"Paper: {r.title} [%]")]
    return Table(
        name="rates",
        caption="Rates with Wilson 95 % intervals",
        head=("Method", *head),
        rows=tuple(rows),
        notes=(
            "Each rate counts all planned trials. A method with fewer than "
            f"{SEEDS_FOR_INTERVAL} seeds has no intervals.",
            *filter(None, [note, *sorted({rejected_text(method.scores) for method in methods})]),
        ),
        numbers=(RATES_NUMBERS, *numbers),
    )


def _in_percent(share: float, low: float | None, high: float | None) -> Rate:
    # The last digits of a product of two floats say nothing.
    of = [None if value is None else round(100 * value, 6) for value in (low, high)]
    return round(100 * share, 6), of[0], of[1]


def _shown(rate: Rate) -> str:
    estimate, low, high = rate
    return f"{estimate:.1f}" + ("" if low is None or high is None else f" ({low:.1f}, {high:.1f})")


SCORES_NUMBERS = ("method", "score", "unit", "median", "trials", "paper_median")


def scores(methods: Sequence[Method], paper: Paper, *, note: str | None = None) -> Table:
    outcomes = paper.scores()
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[object, ...]] = []
    for method in methods:
        cells: list[str] = []
        for outcome in outcomes:
            found = median(outcome.of(score) for score in method.scores if outcome.counts(score))
            printed = method.published.medians.get(outcome.id) if method.published else None
            valid = "" if found.estimate is None else f" (n={found.n_valid})"
            cells += [_shown_score(outcome.id, found.estimate) + valid, _shown_score(outcome.id, printed)]
            numbers.append((method.title, outcome.id, outcome.unit, found.estimate, found.n_valid, printed))
        rows.append((method.title, *cells))
    units = ["" if o.unit == "1" else f" [{'mrad' if o.unit == 'rad' else o.unit}]" for o in outcomes]
    head = [text for o, unit in zip(outcomes, units, strict=True) for text in (f"{o.id}{unit}", f"Paper: {o.id}{unit}")]
    return Table(
        name="scores",
        caption="Medians of the scores over the trials that have them",
        head=("Method", *head),
        rows=tuple(rows),
        notes=(
            "C2 is pooled over Push only. Lower is better for C1 and C5, higher for C2 and C4.",
            *filter(None, [note]),
        ),
        numbers=(SCORES_NUMBERS, *numbers),
    )


def _shown_score(id_: str, value: float | None) -> str:
    """Return a value with as many digits as the paper prints; margins [rad] in mrad, which need no power of ten."""
    if value is None:
        return ABSENT
    if id_ == "C2":
        return f"{1000 * value:.3g}" if abs(value) < 0.1 else f"{1000 * value:.0f}"
    return f"{value:.3f}" if id_ == "C4" else f"{value:.2f}"


TABLES = ("capability", "tasks", "metrics", "protocol", "rates", "scores", "tests", "anatomy")
FIGURES = ("overview", "traces", "force-indentation", "outcomes")
Read = Callable[[str], Recording]
"""Reads the recording of a trial of one run."""


def tables_of(runs: Sequence[RunScores], protocol: Protocol | None) -> list[Table]:
    """Return the tables of runs, each of one policy; an unknown protocol (None) leaves two tables out.

    Raises ConfigError, naming what differs, if the runs must not stand in one table.
    """
    check_comparable({f"run {number} ({run.scores[0].policy if run.scores else 'no policy'})": run.scores
                      for number, run in enumerate(runs, start=1)})  # fmt: skip
    paper = read_paper()
    methods = methods_of(runs, paper)
    note = other_rules(methods, protocol)
    found = [
        capability(paper),
        None if protocol is None else tasks(protocol, paper, methods),
        metrics(paper),
        None if protocol is None else protocol_table(protocol, paper, methods),
        rates(methods, note=note),
        scores(methods, paper, note=note),
        contrasts(methods, paper, note=note),
        anatomy(methods, note=note),
    ]
    return [table for table in found if table is not None]


def write_tables(tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write each table as NAME.tex, NAME.csv and NAME.md. Returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for table in tables:
        for ending, text in (("tex", table.latex()), ("csv", table.csv()), ("md", table.markdown())):
            written.append(folder / f"{table.name}.{ending}")
            replace_file(written[-1], text.encode())
    return written


def write_figures(runs: Sequence[RunScores], read: Mapping[int, Read], folder: Path) -> list[Path]:
    """Write the figures that the runs allow: without recordings, those of traces and indentation are left out.

    Args:
        runs: each of one policy, of one protocol.
        read: number of a run in ``runs`` -> what reads its recordings, for the runs that have them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    methods = methods_of(runs, read_paper())
    chosen = one_of_each_task([methods[number] for number in read])
    shown = dict(zip(read, chosen, strict=True))
    recordings = [[read[number](trial_id) for trial_id in shown.get(number, [])] for number in range(len(methods))]
    drawn: dict[str, Callable[..., None]] = {"overview": paper_figures.draw_overview}
    if read:
        drawn["traces"] = partial(paper_figures.draw_traces, methods=methods, recordings=recordings)
        drawn["force-indentation"] = partial(paper_figures.draw_indentation, methods=methods, recordings=recordings)
    drawn["outcomes"] = partial(paper_figures.draw_outcomes, methods=methods, paths=recordings)
    return [path for name, draw in drawn.items() for path in write_figure(draw, folder, name)]


def remove_earlier(folder: Path, written: Sequence[Path]) -> list[Path]:
    """Remove the tables and figures that an earlier build wrote and this one did not: they are of other runs.

    Args:
        folder: the one that holds ``tables`` and ``figures``.
        written: what this build wrote.
    """
    known = [folder / "tables" / f"{name}.{ending}" for name in TABLES for ending in ("tex", "csv", "md")]
    known += [folder / "figures" / f"{name}.{ending}" for name in FIGURES for ending in NO_DATE]
    earlier = [path for path in known if path not in written and path.is_file()]
    for path in earlier:
        path.unlink()
    return earlier


def one_of_each_task(methods: Sequence[Method]) -> list[list[str]]:
    """Return for each method one trial of each of its tasks: the one that most methods have, so that all are drawn on
    one person; of these the one in which most succeed, then in which most touch, then of the first seed."""
    every: dict[str, list[TrialScore]] = {}
    for method in methods:
        for score in method.scores:
            every.setdefault(score.trial_id, []).append(score)

    def worth(score: TrialScore) -> tuple[int, int, int, int]:
        same = every[score.trial_id]
        return len(same), sum(s.c3_success for s in same), sum(s.valid_contact for s in same), -score.seed

    found: list[list[str]] = []
    for method in methods:
        ordered = sorted(method.scores, key=lambda score: score.task_id)
        by_task = groupby(ordered, key=lambda score: score.task_id)
        found.append([max(scores, key=worth).trial_id for _, scores in by_task])
    return found
