"""What the runs of the study say together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from tools.study.beside import Beside, beside
from tools.study.method import Method, RunHead, head_of, method_of
from tools.study.plan import BASELINES, METHODS, PAIR, PROPOSAL, SWEEPS, command, wanted_runs
from tools.study.sorted_runs import SortedRuns
from tools.study.sweep import Sweep, sweep_of

from carecontact import __version__
from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError, counted
from carecontact.reports.compare.baselines import Baselines, beside_baselines
from carecontact.reports.compare.comparison import Comparison, compare_runs
from carecontact.reports.compare.overview import Overview, overview
from carecontact.reports.compare.plain import plain
from carecontact.reports.paper.published import Paper
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores

STUDY_SCHEMA = "carecontact-study-2"


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
    baselines: dict[str, Baselines]
    """Method -> the blind baselines beside it"""
    overview: Overview | None
    """Ranking of the methods under every other gate"""
    sweeps: tuple[Sweep, ...]
    """Those of which any run is there"""


def study(runs: SortedRuns, *, protocol: Protocol, paper: Paper) -> Study:
    """Compare state-machine with voxposer, and name what is missing.

    Raises ConfigError, naming the runs, for runs of different worlds, or none under the protocol's own conditions.
    """
    found = runs.found
    wanted = wanted_runs(protocol)
    own = {policy: run for (policy, condition), (_, run) in found.items() if not condition}
    methods = {name: own[name] for name in METHODS if name in own}
    if not methods:
        raise ConfigError(
            f"none of {counted(len(found) + len(runs.unused), 'run')} is of {', '.join(METHODS)} "
            f"on {protocol.title} as it is"
        )
    blind = [own[name] for name in BASELINES if name in own]
    comparison, proposal = (
        compare_runs(*(own[name] for name in pair)) if set(pair) <= own.keys() else None for pair in (PAIR, PROPOSAL)
    )
    return Study(
        protocol_id=protocol.id,
        protocol_sha256=protocol.sha256,
        world=_one_world({name: run for name, run in found.values()}),
        methods={name: method_of(run, protocol) for name, run in methods.items()},
        heads=tuple(head_of(found[key][1], protocol) for key in wanted if key in found),
        commands=tuple(command(*key, protocol) for key in wanted if key in found),
        missing=tuple(command(*key, protocol) for key in wanted if key not in found),
        unused=runs.unused,
        comparison=comparison,
        beside=() if comparison is None else tuple(beside(comparison, paper)),
        proposal=proposal,
        baselines={name: beside_baselines(run, blind) for name, run in methods.items()} if blind else {},
        overview=overview(list(methods.values())) if len(methods) > 1 else None,
        sweeps=tuple(sweep for field in SWEEPS if (sweep := sweep_of(field, found, protocol)).was_run),
    )


def study_json(found: Study) -> dict[str, Any]:
    """The content of the page's JSON. Rates and their differences are fractions; infinity and NaN are null."""
    content = {"schema": STUDY_SCHEMA, "carecontact": __version__, **asdict(found)}
    return {key: plain(value) for key, value in content.items()}


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
                        f"{other} and {name} were simulated in different worlds: {what} {there[:12]} and {value[:12]}; "
                        "run both with the same release and robot"
                    )
    return {what: value for what, (_, value) in sorted(first.items())}
