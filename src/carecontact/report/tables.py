"""The tables of a run: medians by task, limits of pain, and what the person bore."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from carecontact.protocol.protocol import Protocol
from carecontact.report.words import NA, NOT_DEFINED, shown, shown_unit, task_name
from carecontact.runs.pooling import check_one_run, decides_force, judged, share, task_of
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.metrics.metric import METRICS, Metric, described, metrics_in_order, newest
from carecontact.scoring.result import TrialScore
from carecontact.stats import Median, Proportion, median, wilson_interval

POOLED = "all"
COUNTS = ("task", "name", "n", "success", "region-correct", "safety-gated")


def headlines() -> list[Metric]:
    """Return the metrics that have a column of their own."""
    return [row for row in metrics_in_order() if row.headline and row.median]


def columns() -> tuple[str, ...]:
    """Return heads of the columns of ``SummaryRow.cells``."""
    return (*COUNTS, *(row.label for row in headlines()))


@dataclass(frozen=True, kw_only=True)
class SummaryRow:
    """Counts and medians of one task, or of all trials (``task_id`` is POOLED)."""

    task_id: str
    name: str
    n: int
    """Trials with a verdict."""
    unknown: int
    """Planned trials without one."""
    success: int
    region_correct: int
    safety_gated: int
    medians: dict[str, Median]
    """Id of a headline metric -> its median over the trials that it is pooled over."""

    def cells(self) -> list[str]:
        """Return strings under ``columns``; a median carries its valid n where that is not the row's n."""
        rates = [self.share(k) for k in (self.success, self.region_correct, self.safety_gated)]
        return [self.task_id, self.name, self.trials, *rates, *self.median_cells()]

    @property
    def trials(self) -> str:
        """``18``, or ``15 of 18`` where planned trials have no verdict."""
        return f"{self.n} of {self.n + self.unknown}" if self.unknown else str(self.n)

    def share(self, k: int) -> str:
        """Return a count over the planned trials: ``9/18``, or ``9–12/18`` where three have no verdict."""
        return f"{k}–{k + self.unknown}/{self.n + self.unknown}" if self.unknown else f"{k}/{self.n}"

    def median_cells(self) -> list[str]:
        rows = [(METRICS[id_], found) for id_, found in self.medians.items()]
        return [
            _median_cell(metric, found, self.n, 1.0, metric.unit) if found.n or metric.actions is None else NOT_DEFINED
            for metric, found in rows
        ]


def _median_cell(metric: Metric, found: Median, n: int, factor: float, unit: str) -> str:
    """Return a median, with the number of trials that it is over where that is not ``n``."""
    if found.estimate is None:
        return NA
    text = shown(factor * found.estimate, digits=metric.digits, unit=unit)
    return text + (f" (n={found.n_valid})" if found.n_valid != n else "")


def sorted_scores(scores: Iterable[TrialScore]) -> list[TrialScore]:
    return sorted(scores, key=lambda s: (s.task_id, s.seed, s.trial_id))


def summary_rows(scores: Sequence[TrialScore], unknown: Iterable[str] | None = None) -> list[SummaryRow]:
    """Return one row per task in task order, then one over all trials; empty without scores.

    Trials without a verdict make every count an interval. Raises ConfigError as ``check_one_run``.

    Args:
        unknown: ids of the planned trials without a verdict; default: those in which the harness failed.
    """
    lacking = [s.trial_id for s in scores if not s.is_judged] if unknown is None else list(unknown)
    check_one_run(scores)
    if not scores:
        return []
    ordered = sorted_scores(scores)
    tasks: dict[str, list[TrialScore]] = {}
    for score in ordered:
        tasks.setdefault(score.task_id, []).append(score)
    rows = [
        counts_of(task_id, task_name(group[0]), group, unknown=sum(task_of(trial) == task_id for trial in lacking))
        for task_id, group in tasks.items()
    ]
    return [*rows, counts_of(POOLED, "All trials", ordered, unknown=len(lacking))]


def counts_of(task_id: str, name: str, group: Sequence[TrialScore], *, unknown: int) -> SummaryRow:
    """``unknown``: planned trials without a verdict, those of ``group`` in which the harness failed included."""
    group = judged(group)
    return SummaryRow(
        task_id=task_id,
        name=name,
        n=len(group),
        unknown=unknown,
        success=sum(s.c3_success for s in group),
        region_correct=sum(s.region_correct for s in group),
        safety_gated=sum(s.safety_gated for s in group),
        medians={row.id: median(row.pooled(group)) for row in headlines()},
    )


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    name: str
    note: str
    """Source of the limit, and whether it was checked."""
    above: Proportion
    """Trials, failed ones too, with a touched segment above the limit, of those that ``decides_force`` leaves."""
    unknown: int
    """Planned trials without a verdict."""
    n_success: int
    """How many of these trials succeeded all the same."""
    worst: float | None
    """Largest peak over its limit of any trial; None where nothing was touched."""
    worst_at: str
    """Trial and segment; empty where nothing was touched."""

    @property
    def count(self) -> str:
        """``2 of 15``, or ``2 to 5 of 18`` where three planned trials have no verdict."""
        return share(self.above.k, self.above.n, self.unknown)


def limit_rows(scores: Sequence[TrialScore], *, gamma: float | None, unknown: int = 0) -> list[LimitRow]:
    """Return one row for each set of limits over the trials that are ``judged``: the safety gate first, and packs that
    the protocol does not use last. Empty where no trial decides: the policy crashed in every one before any contact.

    Args:
        gamma: the protocol's discount, for the name of the gate; None where no recording could be read.
        unknown: planned trials without a verdict.
    """
    counted = decides_force(judged(scores))
    if not counted:
        return []
    own = {s.metric_versions.get("limits", "") for s in counted}
    share = "the protocol's share" if gamma is None else f"{gamma:g}"
    title = ", ".join(LIMIT_PACKS[p].title if p in LIMIT_PACKS else p for p in sorted(own) if p) or "pain limits"
    touched = [(s, segment, peak) for s in counted for segment, peak in s.peak_force_n.items()]
    of_pain = [(peak / s.f_pain_n[segment], s, segment) for s, segment, peak in touched]
    of_gate = [(ratio / gamma, s, segment) for ratio, s, segment in of_pain] if gamma is not None else []
    gated = {s.trial_id for s in counted if s.over_limit}
    rows = [
        (f"Safety gate, {share} of the pain limit", "decides whether a trial is safety-gated", of_gate, gated),
        (title, "the protocol's pain limits, F_pain", of_pain, _over(of_pain)),
    ]
    for name, pack in LIMIT_PACKS.items():
        if name not in own and pack.unit == "N":
            ratios = [(peak / pack.limit(segment), s, segment) for s, segment, peak in touched]
            rows.append((pack.title, pack.source, ratios, _over(ratios)))
    found: list[LimitRow] = []
    for name, note, ratios, over in rows:
        above = [s for s in counted if s.trial_id in over]
        worst = max(ratios, key=lambda row: row[0], default=None)
        found.append(
            LimitRow(
                name=name,
                note=note,
                above=wilson_interval(len(above), len(counted)),
                unknown=unknown,
                n_success=sum(s.c3_success for s in above),
                worst=None if worst is None else worst[0],
                worst_at="" if worst is None else f"{worst[1].trial_id}, {worst[2].replace('_', ' ')}",
            )
        )
    return found


def _over(ratios: Sequence[tuple[float, TrialScore, str]]) -> set[str]:
    return {score.trial_id for ratio, score, _ in ratios if ratio > 1.0}


@dataclass(frozen=True, kw_only=True)
class LoadRow:
    """One metric: a median for each task and, last, one over all trials."""

    metric: Metric
    medians: tuple[Median, ...]

    @property
    def unit(self) -> str:
        """Unit of the cells; empty for a plain number."""
        return shown_unit(self.metric)[1]

    @property
    def label(self) -> str:
        """The metric's name and the unit of the cells."""
        return f"{self.metric.name} [{self.unit}]" if self.unit else self.metric.name

    def cells(self, contacts: Sequence[int]) -> list[str]:
        """Return one string per median, with its number of trials where that is not the one of ``contacts``."""
        factor, unit = shown_unit(self.metric)
        rows = zip(self.medians, contacts, strict=True)
        return [_median_cell(self.metric, found, n, factor, unit) if found.n else NOT_DEFINED for found, n in rows]


@dataclass(frozen=True, kw_only=True)
class Load:
    tasks: tuple[str, ...]
    n: tuple[int, ...]
    """Number of trials of each task and, last, of all tasks, without harness errors."""
    contacts: tuple[int, ...]
    """Number of these trials with valid contact."""
    rows: tuple[LoadRow, ...]


def load(scores: Sequence[TrialScore], *, every: bool = False) -> Load:
    """Return medians over the trials that are ``judged``, of each metric of which any trial has a value.

    Args:
        every: whether the metrics that have a column of their own elsewhere, and the details, have a row here too.
    """
    counted = sorted_scores(judged(scores))
    tasks = tuple(dict.fromkeys(s.task_id for s in counted))
    groups = [*([s for s in counted if s.task_id == task] for task in tasks), counted]
    shown = [metric for metric in _metrics(counted) if metric.median]
    if not every:
        shown = [metric for metric in shown if not (metric.headline or metric.detail)]
    rows: list[LoadRow] = []
    for metric in shown:
        of_groups = [[score for score in group if metric.concerns(score.action)] for group in groups]
        rows.append(LoadRow(metric=metric, medians=tuple(median(metric.pooled(group)) for group in of_groups)))
    return Load(
        tasks=tasks,
        n=tuple(map(len, groups)),
        contacts=tuple(sum(s.valid_contact for s in group) for group in groups),
        rows=tuple(row for row in rows if every or any(found.n_valid for found in row.medians)),
    )


def _metrics(scores: Sequence[TrialScore]) -> list[Metric]:
    """Return the metrics by which any of these trials was scored, in the order of tables; of several versions, the
    newest."""
    further = newest({id_ for score in scores for id_ in score.additional})
    with_field = [metric for metric in METRICS.values() if metric.field is not None] if scores else []
    return sorted([*with_field, *map(described, further)], key=lambda metric: (metric.order, metric.id))


ASKED = ("effective", "comfortable", "comfortable_fragile")
"""Names of the yes-or-no metrics; of each, the newest version counts by which the trials were scored."""
TOOL = "mitt"
"""A rigid cap presses a few square centimetres, so that these metrics say nothing of it."""


@dataclass(frozen=True, kw_only=True)
class NursingRow:
    metric: str
    title: str
    yes: int
    n: int
    """Trials with a value."""


def nursing_rows(scores: Sequence[TrialScore], protocol: Protocol | None) -> list[NursingRow]:
    """Return one row per metric of ASKED over the trials that are ``judged``; none where the tool is not the mitt.

    Args:
        protocol: of the run, as a recording of it holds it; None where none could be read: then the tool is unknown.
    """
    if protocol is None or protocol.scene.tool != TOOL:
        return []
    counted = judged(scores)
    rows: list[NursingRow] = []
    scored = newest({id_ for score in counted for id_ in score.additional if id_ in METRICS})
    for name in (id_ for asked in ASKED for id_ in scored if id_.partition("@")[0] == asked):
        values = [value for value in METRICS[name].pooled(counted) if value is not None]
        if values:
            rows.append(NursingRow(metric=name, title=METRICS[name].title, yes=sum(map(int, values)), n=len(values)))
    return rows
