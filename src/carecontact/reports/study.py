"""The evaluated methods on one protocol beside the paper: which runs there are, and what they say together.

A run is known by what its trials say of themselves (policy, overrides), never by the name of its folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from carecontact import __version__
from carecontact.contract.protocol import Protocol, protocol_title
from carecontact.errors import ConfigError
from carecontact.protocols import adapted
from carecontact.reports.compare.comparison import Comparison, compare_runs, plain
from carecontact.reports.compare.null_floors import NullFloors, null_floors
from carecontact.reports.compare.outcomes import RATES, SCORES, Outcome
from carecontact.reports.compare.overview import Overview, overview
from carecontact.reports.compare.paired_lines import Line
from carecontact.reports.page.failures import AnatomyRow, Cause, anatomy, causes, failure_modes
from carecontact.reports.paper import Paper
from carecontact.reports.table import SummaryRow, summary_rows
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores, joined
from carecontact.stats import Proportion, RankingSweep, ranking_sweep, wilson_interval

STUDY_SCHEMA = "carecontact-study-1"
PAIR = ("state-machine", "voxposer")
PROPOSAL = ("voxposer-phased", "voxposer")
"""What the paper proposes and does not evaluate, against what it would change."""
METHODS = (*PAIR, PROPOSAL[0])
NULL_ARMS = ("zero-action", "hover", "random", "replay")
STIFFNESS, TISSUE = "impedance.translational_n_m", "person.tissue_set"
SWEEPS: dict[str, tuple[str, ...]] = {STIFFNESS: ("200", "400", "1000"), TISSUE: ("paper-mapping", "manikin-like")}
"""Field -> its values, of which one is the protocol's own."""
OPTION = {STIFFNESS: "--stiffness", TISSUE: "--tissue"}
PRIMARY = ("success", "region_correct", "safety_gated", "C1", "C5")
"""Outcomes that state-machine and voxposer are compared on beside the paper, and ranked on in the sweeps."""
Agreement = Literal["as in the paper", "against the paper", "not seen here", "open"]
Condition = tuple[tuple[str, str], ...]
"""Overrides as sorted pairs; () is the protocol itself."""


@dataclass(frozen=True, kw_only=True)
class RunHead:
    policy: str
    title: str
    """Of the protocol with its overrides"""
    language_backend: tuple[str, ...]
    n: int
    """Trials that say something about the policy"""
    n_planned: int
    """Tasks times seeds of the protocol"""
    n_harness_errors: int
    skipped: dict[str, str]
    versions: dict[str, list[str]]


@dataclass(frozen=True, kw_only=True)
class Method:
    head: RunHead
    rates: dict[str, Proportion]
    summary: tuple[SummaryRow, ...]
    """One row a task, then all"""
    modes: tuple[dict[str, Any], ...]
    causes: tuple[Cause, ...]
    anatomy: tuple[AnatomyRow, ...]


@dataclass(frozen=True, kw_only=True)
class Beside:
    """One outcome of state-machine against voxposer: what is found here and what the paper has."""

    outcome: Outcome
    line: Line
    paper_a: float
    paper_b: float
    paper_test: tuple[str, float] | None
    """Test and p; None where the paper has none"""
    agreement: Agreement


@dataclass(frozen=True, kw_only=True)
class Level:
    value: str
    is_protocol: bool
    comparison: Comparison | None
    """state-machine against voxposer; None where a run is missing"""
    gated: dict[str, dict[str, tuple[int, int]]]
    """Method -> task -> safety-gated trials, of how many; of the runs that are there"""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    field: str
    levels: tuple[Level, ...]
    ranking: dict[str, RankingSweep]
    """Outcome -> Kendall's tau of each level's order against that under the protocol; empty without the latter"""

    @property
    def was_run(self) -> bool:
        """Under any condition but the protocol's own."""
        return any(level.gated and not level.is_protocol for level in self.levels)


@dataclass(frozen=True, kw_only=True)
class Study:
    protocol_id: str
    protocol_sha256: str
    world: dict[str, str]
    """Body, robot and MuJoCo of all runs"""
    methods: dict[str, Method]
    heads: tuple[RunHead, ...]
    """Of every run that is used"""
    commands: tuple[str, ...]
    """That make the runs"""
    missing: tuple[str, ...]
    """Commands whose runs are not there"""
    unused: dict[str, str]
    """Run -> why it is in no table"""
    comparison: Comparison | None
    beside: tuple[Beside, ...]
    proposal: Comparison | None
    """voxposer-phased against voxposer"""
    floors: dict[str, NullFloors]
    overview: Overview | None
    """Ranking of the methods under every other gate"""
    sweeps: tuple[Sweep, ...]
    """Those of which any run is there"""


def study(runs: SortedRuns, *, protocol: Protocol, paper: Paper) -> Study:
    """Compare state-machine with voxposer, and name what is missing.

    Raises ConfigError, naming the runs, for runs of different worlds, or none under the protocol's own conditions.
    """
    found = runs.found
    wanted = _wanted(protocol)
    own = {policy: run for (policy, condition), (_, run) in found.items() if not condition}
    methods = {name: own[name] for name in METHODS if name in own}
    if not methods:
        raise ConfigError(
            f"none of {len(found) + len(runs.unused)} run(s) is of {', '.join(METHODS)} on {protocol.title} as it is"
        )
    nulls = [own[name] for name in NULL_ARMS if name in own]
    comparison, proposal = (
        compare_runs(*(own[name] for name in pair)) if set(pair) <= own.keys() else None for pair in (PAIR, PROPOSAL)
    )
    return Study(
        protocol_id=protocol.id,
        protocol_sha256=protocol.sha256,
        world=_one_world({name: run for name, run in found.values()}),
        methods={name: _method(run, protocol) for name, run in methods.items()},
        heads=tuple(_head(found[key][1], protocol) for key in wanted if key in found),
        commands=tuple(_command(*key, protocol) for key in wanted if key in found),
        missing=tuple(_command(*key, protocol) for key in wanted if key not in found),
        unused=runs.unused,
        comparison=comparison,
        beside=() if comparison is None else tuple(_beside(comparison, paper)),
        proposal=proposal,
        floors={name: null_floors(run, nulls) for name, run in methods.items()} if nulls else {},
        overview=overview(list(methods.values())) if len(methods) > 1 else None,
        sweeps=tuple(sweep for field in SWEEPS if (sweep := _sweep(field, found, protocol)).was_run),
    )


def study_json(found: Study) -> dict[str, Any]:
    """The content of the page's JSON. Rates and their differences are fractions; infinity and NaN are null."""
    content = {"schema": STUDY_SCHEMA, "carecontact": __version__, **asdict(found)}
    return {key: plain(value) for key, value in content.items()}


Found = dict[tuple[str, Condition], tuple[str, RunScores]]
"""(policy, condition) -> name and scores"""


@dataclass(frozen=True, kw_only=True)
class SortedRuns:
    found: Found
    """Those that a study has a place for"""
    unused: dict[str, str]
    """Name -> why it is in none"""


def sorted_out(runs: Mapping[str, RunScores], protocol: Protocol) -> SortedRuns:
    """By what their trials say of themselves.

    Args:
        runs: name for messages -> scores; those of one policy under the same conditions are parts of one run.

    Raises ConfigError, naming the runs, for parts that have a trial in common, or a run of another state of the
    protocol.
    """
    found: Found = {}
    unused: dict[str, str] = {}
    wanted = _wanted(protocol)
    for name, run in runs.items():
        if not judged(run.scores):
            unused[name] = "no trial that says anything about its policy"
            continue
        first = run.scores[0]
        condition = tuple(sorted(first.overrides.items()))
        if first.protocol_id != protocol.id:
            unused[name] = f"of {first.protocol_title}"
        elif (first.policy, condition) not in wanted:
            unused[name] = f"{first.policy} on {first.protocol_title} is no part of this study"
        else:
            expected = _under(protocol, condition)
            if first.protocol_sha256 != expected.sha256:
                raise ConfigError(
                    f"{name} was made with another state of {first.protocol_title} ({first.protocol_sha256[:12]}; "
                    f"here it is {expected.sha256[:12]}): run it again with this release"
                )
            part = found.get((first.policy, condition))
            if part is not None:
                name, run = _whole(part, (name, run))
            found[first.policy, condition] = name, run
    return SortedRuns(found=found, unused=unused)


def _whole(a: tuple[str, RunScores], b: tuple[str, RunScores]) -> tuple[str, RunScores]:
    try:
        return f"{a[0]} and {b[0]}", joined(a[1], b[1])
    except ConfigError as error:
        first = b[1].scores[0]
        raise ConfigError(
            f"{a[0]} and {b[0]} are both {first.policy} on {first.protocol_title} and no parts of one run: {error}"
        ) from None


def _conditions(protocol: Protocol) -> list[Condition]:
    """One for each value of a sweep that is not the protocol's own."""
    own = {STIFFNESS: f"{protocol.impedance.translational_n_m:g}", TISSUE: protocol.person.tissue_set}
    return [((field, value),) for field, values in SWEEPS.items() for value in values if value != own[field]]


def _under(protocol: Protocol, condition: Condition) -> Protocol:
    said = dict(condition)
    stiffness = said.get(STIFFNESS)
    return adapted(protocol, tissue=said.get(TISSUE), stiffness_n_m=None if stiffness is None else float(stiffness))


def _wanted(protocol: Protocol) -> list[tuple[str, Condition]]:
    """Policy and condition of every run that the study has a place for."""
    own = [(name, ()) for name in (*METHODS, *NULL_ARMS)]
    return [*own, *((name, condition) for condition in _conditions(protocol) for name in PAIR)]


def _command(policy: str, condition: Condition, protocol: Protocol) -> str:
    options = "".join(f" {OPTION[field]} {value}" for field, value in condition)
    folder = run_name(policy, dict(condition))
    return f"carecontact run --policy {policy} --protocol {protocol.id}{options} --out runs/{protocol.id}/{folder}"


def run_name(policy: str, overrides: Mapping[str, str]) -> str:
    """What a run of the study is called, as a folder or a file."""
    return "-".join([policy, *(value for _, value in sorted(overrides.items()))])


def _one_world(runs: Mapping[str, RunScores]) -> dict[str, str]:
    """Across conditions too; the compiled model differs there, as it should."""
    first: dict[str, tuple[str, str]] = {}
    for name, run in runs.items():
        for score in judged(run.scores):
            for what, value in score.world.items():
                if what == "model":
                    continue
                other, there = first.setdefault(what, (name, value))
                if there != value:
                    raise ConfigError(
                        f"{other} and {name} are of different worlds: {what} {there[:12]} and {value[:12]}; run both "
                        "with one release and one robot"
                    )
    return {what: value for what, (_, value) in sorted(first.items())}


def _head(run: RunScores, protocol: Protocol) -> RunHead:
    counted = judged(run.scores)
    return RunHead(
        policy=counted[0].policy,
        title=counted[0].protocol_title,
        language_backend=tuple(sorted({s.language_backend for s in counted})),
        n=len(counted),
        n_planned=len(protocol.tasks) * len(protocol.randomization.seeds),
        n_harness_errors=len(run.scores) - len(counted),
        skipped=run.skipped,
        versions=run.versions,
    )


def _method(run: RunScores, protocol: Protocol) -> Method:
    counted = judged(run.scores)
    return Method(
        head=_head(run, protocol),
        rates={r.id: wilson_interval(sum(bool(getattr(s, r.field)) for s in counted), len(counted)) for r in RATES},
        summary=tuple(summary_rows(run.scores)),
        modes=tuple(failure_modes(run.scores)),
        causes=tuple(causes(run.scores)),
        anatomy=tuple(anatomy(run.scores)),
    )


def _beside(comparison: Comparison, paper: Paper) -> list[Beside]:
    a, b = (paper.methods[name] for name in PAIR)
    rows: list[Beside] = []
    for line in comparison.overall:
        outcome = line.outcome
        if outcome.id in PRIMARY:
            there = a.value(outcome) - b.value(outcome)
            rows.append(
                Beside(
                    outcome=outcome, line=line, paper_a=a.value(outcome), paper_b=b.value(outcome),
                    paper_test=paper.pvalues.get(outcome.id), agreement=_agreement(line, there),
                )
            )  # fmt: skip
    return rows


def _agreement(line: Line, in_paper: float) -> Agreement:
    """``open``: this comparison could have missed a difference that matters."""
    assert line.verdict is not None
    if line.verdict.word in ("A higher", "B higher"):
        return "as in the paper" if (in_paper > 0) == (line.verdict.word == "A higher") else "against the paper"
    return "not seen here" if line.verdict.word == "no difference seen" else "open"


def _sweep(field: str, found: Found, protocol: Protocol) -> Sweep:
    foreign = {value: condition for condition in _conditions(protocol) for name, value in condition if name == field}
    levels: list[Level] = []
    for value in SWEEPS[field]:
        here = {
            name: found[name, condition][1]
            for name, condition in ((name, foreign.get(value, ())) for name in PAIR)
            if (name, condition) in found
        }
        levels.append(
            Level(
                value=value,
                is_protocol=value not in foreign,
                comparison=compare_runs(*here.values()) if len(here) == len(PAIR) else None,
                gated={
                    name: {row.task_id: (row.safety_gated, row.n) for row in summary_rows(run.scores)[:-1]}
                    for name, run in here.items()
                },
            )
        )
    present = [level for level in levels if level.comparison is not None]
    reference = next((level.value for level in present if level.is_protocol), None)
    ranking: dict[str, RankingSweep] = {}
    if reference is not None:
        for outcome in (o for o in (*RATES, *SCORES) if o.id in PRIMARY):
            values = {level.value: standing(level, outcome) for level in present}
            ranking[outcome.id] = ranking_sweep(values, reference=reference)
    return Sweep(field=field, levels=tuple(levels), ranking=ranking)


def standing(level: Level, outcome: Outcome) -> dict[str, float | None]:
    """Method -> its rate or median over the trials that both have, negative where lower is better."""
    assert level.comparison is not None
    line = next(line for line in level.comparison.overall if line.outcome.id == outcome.id)
    sign = 1 if outcome.better == "higher" else -1
    values: Sequence[float | None] = (line.a.estimate, line.b.estimate)
    return {name: None if v is None else sign * v for name, v in zip(PAIR, values, strict=True)}


def condition_title(field: str, value: str) -> str:
    return protocol_title("", {field: value}).removeprefix(" with ")
