"""More than two runs side by side, and whether their ranking stays the same with other values of the gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from string import ascii_uppercase
from typing import Any

from carecontact.errors import ConfigError
from carecontact.report.baselines import Baselines, role_in
from carecontact.report.comparison import check_comparable, conclude, document, machines_text, trials_by_key
from carecontact.report.paired import RATES, Line, rate_lines
from carecontact.report.tables import SummaryRow, summary_rows
from carecontact.runs.pooling import Over, RunScores, over_of, rate_of, rejected_text
from carecontact.runs.results_file import gamma_sweep, gate_sweep
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, RankingSweep, ranking_sweep

GAMMAS = tuple(round(0.2 + 0.05 * i, 2) for i in range(17))
REFERENCE = "safety_gated"
"""Level of a sweep at which every gate has the protocol's own value."""
STEPS = {REFERENCE: "safety_gated", "region_correct": "region_correct", "success": "c3_success"}
"""Level -> field of a score."""


@dataclass(frozen=True, kw_only=True)
class Ranking:
    order: tuple[tuple[str, ...], ...]
    """Methods by their share of safety-gated trials under the protocol's own gates, best first; equal ones together."""
    shares: dict[str, dict[str, float | None]]
    """Level -> method -> share of its trials. ``gamma 0.35`` and ``push_force_n 5`` are safety-gated shares there."""
    sweep: RankingSweep
    """Every level against the reference."""

    def least_by_sweep(self) -> dict[str, tuple[float | None, str]]:
        """Sweep -> its smallest tau, and the level where that is; None where no level orders the methods."""
        out: dict[str, tuple[float | None, str]] = {}
        for level, found in self.sweep.tau.items():
            if level == self.sweep.reference:
                continue
            name = level.partition(" ")[0]
            least, _ = out.setdefault(name, (None, ""))
            if found.tau is not None and (least is None or found.tau < least):
                out[name] = (found.tau, level)
        return out


def rank(methods: Mapping[str, Sequence[TrialScore]]) -> Ranking:
    """Order methods by safety-gated trials, and again at every other step of the funnel, discount and swept gate.

    Args:
        methods: name -> its judged trials; the same tasks and seeds for all, at least two methods.
    """
    shares: dict[str, dict[str, float | None]] = {}
    for name, scores in methods.items():
        passed = {step: sum(bool(getattr(s, field)) for s in scores) for step, field in STEPS.items()}
        passed |= {f"gamma {row['gamma']:g}": row["safety_gated"] for row in gamma_sweep(scores, GAMMAS)}
        for gate, rows in gate_sweep(scores).items():
            passed |= {f"{gate} {row['value']:g}": row["safety_gated"] for row in rows}
        for level, k in passed.items():
            shares.setdefault(level, {})[name] = k / len(scores) if scores else None
    shares = {level: found for level, found in shares.items() if found.keys() == methods.keys()}
    best = shares[REFERENCE]
    values = sorted({v for v in best.values() if v is not None}, reverse=True)
    return Ranking(
        order=tuple(tuple(name for name in methods if best[name] == value) for value in values),
        shares=shares,
        sweep=ranking_sweep(shares, reference=REFERENCE),
    )


OVERVIEW_SCHEMA = "carecontact-overview-2"


@dataclass(frozen=True, kw_only=True)
class PairOfRuns:
    a: str
    b: str
    lines: tuple[Line, ...]
    """One line for each rate. Differences are a minus b, and A and B of a verdict are this a and this b. The lines of
    all pairs are one family for Holm's method."""


@dataclass(frozen=True, kw_only=True)
class Overview:
    protocol_id: str
    protocol_sha256: str
    overrides: dict[str, str]
    metric_versions: dict[str, str]
    policies: dict[str, str]
    """Letter -> policy; in the order given."""
    n: int
    """Trials of the same task and seed in every run; everything here is over them alone."""
    seeds: int
    """Different seeds of these trials."""
    left_out: dict[str, int]
    """Letter -> trials that some other run lacks."""
    over: Over
    """What intervals and tests take as independent: the trials, or the seeds."""
    rows: dict[str, SummaryRow]
    rates: dict[str, dict[str, Proportion]]
    """Letter -> rate -> its share of the trials."""
    pairs: tuple[PairOfRuns, ...]
    machines: str
    """What computed and drew the runs, where it differs; else empty."""
    incomplete: dict[str, str]
    """Letter of a run of which planned trials have no verdict -> how many have one."""
    rejected_tissue: str
    """A sentence for runs on a tissue whose calibration was rejected; else empty."""
    ranking: Ranking | None
    """None where a run is incomplete."""


def overview(runs: Sequence[RunScores]) -> Overview:
    """Raises ConfigError, naming what differs, if the runs must not be compared or share no task and seed, and for a
    baseline among them: only methods are ranked."""
    named = dict(zip(ascii_uppercase, runs, strict=False))
    if len(named) < len(runs):
        raise ConfigError(f"{len(runs)} runs at once; at most {len(ascii_uppercase)}")
    check_comparable({f"run {name}": run.scores for name, run in named.items()})
    _check_methods(named)
    keyed = {name: trials_by_key(run.scores) for name, run in named.items()}
    common = sorted(set.intersection(*(set(trials) for trials in keyed.values())))
    if not common:
        raise ConfigError("these runs have no trial (task and seed) in common; run the same seeds of a task")
    scores = {name: [trials[key] for key in common] for name, trials in keyed.items()}
    found = [(a, b, rate_lines(list(zip(scores[a], scores[b], strict=True)), scores[a], scores[b]))
             for a, b in combinations(named, 2)]  # fmt: skip
    concluded = iter(conclude([line for _, _, lines in found for line in lines]))
    first = runs[0].scores[0]
    return Overview(
        protocol_id=first.protocol_id,
        protocol_sha256=first.protocol_sha256,
        overrides=first.overrides,
        metric_versions=first.metric_versions,
        policies={name: of_run[0].policy_title for name, of_run in scores.items()},
        n=len(common),
        seeds=len({seed for _, seed in common}),
        left_out={name: len(trials) - len(common) for name, trials in keyed.items()},
        over=over_of(first),
        rows={name: summary_rows(of_run)[-1] for name, of_run in scores.items()},
        rates={name: {r.id: rate_of(of_run, r.field) for r in RATES} for name, of_run in scores.items()},
        pairs=tuple(PairOfRuns(a=a, b=b, lines=tuple(next(concluded) for _ in lines)) for a, b, lines in found),
        machines=machines_text({name: run.scores for name, run in named.items()}),
        incomplete=(lacking := {name: run.incomplete for name, run in named.items() if run.incomplete}),
        rejected_tissue=rejected_text(runs[0].scores),
        ranking=None if lacking else rank(scores),
    )


def _check_methods(runs: Mapping[str, RunScores]) -> None:
    for name, run in runs.items():
        role = role_in(run.scores)
        if role != "method":
            policy = run.scores[0].policy_title
            what = "privileged" if role == "privileged" else "a blind baseline" if role == "blind" else "a probe"
            raise ConfigError(
                f"{name} is {policy}, which is {what} and never ranked; name its run with --baseline, so that it "
                "stands beside the methods"
            )


def overview_json(overview: Overview | None, baselines: Mapping[str, Baselines]) -> dict[str, Any]:
    """Return the content of ``overview.json``. Rates and their differences are fractions; infinity and NaN are null.

    Args:
        overview: None where one run alone was given.
        baselines: letter of a run -> the blind baselines beside it.
    """
    beside = {name: asdict(found) for name, found in baselines.items()}
    return document(OVERVIEW_SCHEMA, {"overview": None if overview is None else asdict(overview), "baselines": beside})
