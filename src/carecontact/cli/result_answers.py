"""What commands that show results print with `--json`, and the table of every kind of answer."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers import (
    Answer,
    DoctorAnswer,
    ErrorAnswer,
    ListAnswer,
    Part,
    ProtocolFeasibleAnswer,
    ProtocolListAnswer,
    ProtocolLockAnswer,
    ProtocolShowAnswer,
    ProtocolVerifyAnswer,
    ValidateAnswer,
)
from carecontact.cli.board import BoardEntry
from carecontact.recording.schema import EndReason
from carecontact.report.baselines import Baselines
from carecontact.report.comparison import Comparison
from carecontact.report.overview import Overview
from carecontact.report.sweep_levels import Factors, GateOrder, Ladder
from carecontact.report.sweep_table import Stability
from carecontact.scoring.result import TrialScore
from carecontact.stats import Median

# Counts and medians over trials, as `results.json` has them (docs/scores.md).


class Rate(Part):
    n: int
    """Number of trials that count."""
    pc: float | None
    """Rate [percent]; null if no trial counts, and for an incomplete run."""
    pc_between: tuple[float, float]
    """Rate [percent] if all planned trials without a verdict failed, and if all of them passed."""
    pc_ci95: tuple[float, float] | None
    """95 % interval [percent]. Of success, region-correct and safety-gated trials, it is over persons where a seed is a
    person, and null with fewer than six; else, it is Wilson's over trials. For an incomplete run, it covers both of
    ``pc_between``."""


class Exceedance(Rate):
    n_success: int
    """Number of these trials that are successful."""


class HarmlessRate(Rate):
    of: int
    """Number of trials with at least 1 s of contact on the named region, of which the percentages are."""


class Summary(Part):
    """Counts and medians over the trials with a verdict."""

    n_planned: int
    """Planned trials; more than ``n_episodes`` where the run is incomplete."""
    n_episodes: int
    """Trials with a verdict."""
    n_success: int
    pc_success: float | None
    pc_success_between: tuple[float, float]
    pc_success_ci95: tuple[float, float] | None
    region_correct: Rate
    safety_gated: Rate
    harmless: HarmlessRate
    valid_contact: Rate
    valid_ratio: Rate
    """Share of the trials that have a trajectory to score."""
    exceedances: dict[str, Exceedance]
    """``gate`` and ``pain`` -> number of trials with a force above that limit."""
    quadrants: dict[str, int]
    medians: dict[str, Median]
    """Column of the table, with the trials over which it is pooled -> median."""
    additional: dict[str, Median]
    """Id of a further metric -> median."""
    anatomy: dict[str, int]
    failure_modes: dict[str, int]
    attributions: dict[str, int]


class ScoreAnswer(Answer):
    kind: Annotated[Literal["carecontact-score-1"], Field(alias="schema")] = "carecontact-score-1"
    folder: str
    results: str | None
    """The results.json that was written; null if it stayed as it was."""
    added: list[str] | None
    """Metrics that ``--append`` added; null without this option."""
    skipped: dict[str, str]
    """File that could not be scored -> why."""
    missing: list[str]
    """Planned trials without a score."""
    overall: Summary | None
    """Rates and medians over all trials that could be scored; null if there were none."""
    per_task: dict[str, Summary]
    status: int
    """Exit status of the command."""


class TrialAnswer(Answer):
    """A trial that has ended, or that an earlier command had finished. If scoring then finds the recording of such an
    earlier trial damaged, the trial runs again and gets a second line."""

    kind: Annotated[Literal["carecontact-run-trial-1"], Field(alias="schema")] = "carecontact-run-trial-1"
    trial_id: str
    ended: EndReason
    kept: bool
    """Whether an earlier command ran it."""
    done: int
    """Number of trials that need no more work, this one included."""
    total: int
    message: str | None
    """Why the trial failed, in one line; null for a trial that did not."""
    score: TrialScore | None
    """The score; null for a trial that an earlier command ran and for one that cannot be scored."""


class RunProtocol(Part):
    id: str
    sha256: str
    overrides: dict[str, str]
    """Field -> the value that an option set."""


class RunAnswer(Answer):
    """The last line of a run that came to its end."""

    kind: Annotated[Literal["carecontact-run-1"], Field(alias="schema")] = "carecontact-run-1"
    folder: str
    policy: str
    protocol: RunProtocol
    ended: dict[str, EndReason]
    """Every planned trial that has a recording -> how it ended."""
    ran: list[str]
    """Trials that this command ran."""
    kept: list[str]
    """Trials that an earlier command had finished."""
    late: dict[str, int]
    """Trial -> number of observations that were late for ``--pace``."""
    skipped: dict[str, str]
    """File that could not be scored -> why."""
    overall: Summary | None
    """Rates and medians over all trials; null if nothing could be scored."""
    status: int
    """Exit status of the command."""


class CompareAnswer(Answer):
    """Rates and their differences are fractions. Differences are A minus B."""

    kind: Annotated[Literal["carecontact-compare-1"], Field(alias="schema")] = "carecontact-compare-1"
    alpha: float
    """Level of the whole family of tests."""
    power: float
    """Power at which the smallest detectable difference is given."""
    comparison: Comparison | None
    """The comparison of two runs; null for one run or more than two."""
    overview: Overview | None
    """The overview of more than two runs; else null."""
    baselines: dict[str, Baselines]
    """Letter of a run -> the blind baselines beside it; empty without ``--baseline``."""


class SweepCellAnswer(Answer):
    """One cell of a plan, with `--dry-run`."""

    kind: Annotated[Literal["carecontact-sweep-cell-1"], Field(alias="schema")] = "carecontact-sweep-cell-1"
    policy: str
    """Its label in the tables."""
    values: dict[str, str]
    """Axis -> value."""
    folder: str
    """Where its run is or will be."""
    trials: int
    """Number of planned trials."""
    recorded: int
    """How many of them are recorded."""


class SweepAnswer(Answer):
    """The statements of the page about all cells; sweep.csv has the rows of the cells. Rates and differences are
    fractions.
    """

    kind: Annotated[Literal["carecontact-sweep-1"], Field(alias="schema")] = "carecontact-sweep-1"
    title: str
    axes: tuple[str, ...]
    policies: tuple[str, ...]
    rank_by: str
    trials: int
    """Number of finished and scored trials in all cells."""
    planned: int
    stability: Stability | None
    """Whether the order of the policies holds; null if there is no order."""
    ladder: Ladder | None
    """Success over the protocols of the plan; null if it has only one."""
    factors: Factors | None
    """The effect of each factor alone; null if the plan has no factors."""
    gate_orders: tuple[GateOrder, ...]
    """The order of the policies under other gates."""


ANSWERS: tuple[type[Answer], ...] = (
    ListAnswer,
    DoctorAnswer,
    TrialAnswer,
    RunAnswer,
    ScoreAnswer,
    CompareAnswer,
    SweepAnswer,
    SweepCellAnswer,
    BoardEntry,
    ProtocolListAnswer,
    ProtocolShowAnswer,
    ProtocolVerifyAnswer,
    ProtocolFeasibleAnswer,
    ProtocolLockAnswer,
    ValidateAnswer,
    ErrorAnswer,
)


def name_of(answer: type[Answer]) -> str:
    return answer.model_fields["kind"].default
