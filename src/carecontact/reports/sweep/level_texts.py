"""Success over levels, single factors and other gates, as tables for people."""

from __future__ import annotations

from carecontact.reports.intervals import enough
from carecontact.reports.sweep.factors import Factors
from carecontact.reports.sweep.ladder import Ladder
from carecontact.reports.text import NA
from carecontact.stats import PersonDifference, PersonRate, WorstShare

Rows = list[list[str]]

LEVEL_HEADS = (
    "level", "policy", "passed", "rate [95 %]", "above best blind", "worst tenth [95 %]", "by chance", "harder band",
)  # fmt: skip
CONTRAST_HEADS = ("level", "methods", "trials", "difference [95 %]", "p Holm")
FACTOR_HEADS = (
    "policy", "factor", "factor alone", "against none", "p Holm", "all but it", "against all", "p Holm",
)  # fmt: skip


def level_rows(found: Ladder) -> Rows:
    return [
        [
            level_name(rung.value),
            climb.policy if climb.role == "method" else f"{climb.policy} ({climb.role})",
            f"{climb.rate.k}/{climb.rate.n}",
            rate(climb.rate),
            "best blind" if climb.policy == rung.best_blind else difference(climb.above_blind),
            worst(climb.worst),
            NA if climb.worst.by_chance is None else f"{100 * climb.worst.by_chance:.0f} %",
            NA if climb.harder is None else f"{climb.harder[0]}/{climb.harder[1]}",
        ]
        for rung in found.rungs
        for climb in rung.climbs
        if climb.rate.n
    ]


def task_heads(found: Ladder) -> list[str]:
    return ["level", "policy", *found.tasks]


def task_rows(found: Ladder) -> Rows:
    return [
        [level_name(rung.value), climb.policy, *(_counted(climb.by_task.get(task)) for task in found.tasks)]
        for rung in found.rungs
        for climb in rung.climbs
        if climb.rate.n
    ]


def _counted(passed: tuple[int, int] | None) -> str:
    return NA if passed is None else f"{passed[0]}/{passed[1]}"


def contrast_rows(found: Ladder) -> Rows:
    return [
        [
            level_name(rung.value),
            f"{one.a} - {one.b}",
            str(one.difference.n),
            difference(one.difference),
            pvalue(one.p_holm),
        ]
        for rung in found.rungs
        for one in rung.contrasts
    ]


def factor_rows(found: Factors) -> Rows:
    rows: Rows = []
    for name in found.low:
        rows.append([name, "none", rate(found.low[name]), "", "", "", "", ""])
        rows += [
            [
                name, one.factor, rate(one.alone), difference(one.costs), pvalue(one.costs_p_holm),
                rate(one.without), difference(one.gives_back), pvalue(one.gives_back_p_holm),
            ]
            for one in found.effects
            if one.policy == name
        ]  # fmt: skip
        rows.append([name, "all", "", "", "", rate(found.high[name]), "", ""])
    return rows


def level_name(value: str) -> str:
    """Return a protocol as tables name it: a file by its stem."""
    return value.rsplit("/", 1)[-1].replace(".toml", "")


def rate(found: PersonRate) -> str:
    if found.estimate is None:
        return NA
    return f"{100 * found.estimate:.0f} %{_bounds(found.low, found.high, found.persons, '.0f')}"


def worst(found: WorstShare) -> str:
    if found.estimate is None:
        return NA
    bounds = _bounds(found.low, found.high, found.persons, ".0f")
    return f"{100 * found.estimate:.0f} %{bounds}"


def difference(found: PersonDifference | None) -> str:
    if found is None or found.estimate is None:
        return NA
    return f"{100 * found.estimate:+.0f}{_bounds(found.low, found.high, found.persons, '+.0f')}"


def _bounds(low: float | None, high: float | None, persons: int, shape: str) -> str:
    """Return an interval over persons in per cent; empty with too few of them."""
    if low is None or high is None or not enough(persons):
        return ""
    return f" [{100 * low:{shape}}, {100 * high:{shape}}]"


def pvalue(p: float | None) -> str:
    return NA if p is None else "< 0.0001" if p < 0.0001 else f"{p:.2g}" if p < 0.1 else f"{p:.2f}"
