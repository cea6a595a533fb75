"""What a metric is, and the table of all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, TypeVar, get_args

from carecontact.errors import ConfigError, UnknownNameError
from carecontact.protocol.gates import ACTIONS
from carecontact.registry import Registry
from carecontact.scoring.behaviour import actions_that_move, blamed_on, shown
from carecontact.scoring.contact import Contact
from carecontact.scoring.result import MEASURED, TrialScore

Better = Literal["higher", "lower", "neither"]
Pool = tuple[str, ...] | Literal["moving"] | None
Measured = float | Mapping[str, Any] | None


def _is_pool(value: Any) -> bool:
    return value in (None, "moving") or (isinstance(value, tuple) and value != ())


FIELDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "title": (lambda value: isinstance(value, str) and value != "", "a text"),
    "unit": (lambda value: isinstance(value, str) and value != "", "a text, 1 for a plain number"),
    "better": (lambda value: value in get_args(Better), f"one of {', '.join(get_args(Better))}"),
    "measure": (callable, "a function"),
    "pool": (_is_pool, "None, moving or a tuple of actions"),
    "only": (_is_pool, "None, moving or a tuple of actions"),
    "digits": (lambda value: value is None or (isinstance(value, int) and value >= 0), "None, or a number from 0 up"),
    "matters": (lambda value: value is None or (isinstance(value, int | float) and value > 0), "None, or above 0"),
    "order": (lambda value: isinstance(value, int), "a whole number"),
}
"""Field of a Metric -> whether a value is valid, and what is, in words."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A number of one trial, and how tables, reports and comparisons show it. A changed definition gets a new id
    (``C1@2``); the meaning of an id never changes."""

    id: str
    """Name and version, as in ``C1@1``."""
    title: str
    unit: str
    """``1`` for a plain number."""
    better: Better
    measure: Callable[[Contact], Measured]
    """Pure. Returns the number, or None for NA. A metric with a ``field`` may return several fields of ``TrialScore``
    with their values instead, where one computation fills them."""
    field: str | None = None
    """Field of ``TrialScore`` that holds the number; None: it is in ``TrialScore.additional`` under the metric's id."""
    pool: Pool = None
    """Medians and comparisons pool the trials of these actions only; ``moving``: of those whose behaviour is meant to
    move the person; None: of all."""
    only: Pool = None
    """The metric says something about trials of these actions only: tables by task and pages of trials leave it out of
    the others, which results and medians keep. None: of those of ``pool``."""
    median: bool = True
    """Whether tables show a median of it."""
    digits: int | None = None
    """Decimals in tables; None: about three digits in all."""
    detail: bool = False
    """Whether the tables of a report leave the metric out, because other rows say the same or it needs an expert;
    results, ``report --verbose`` and the page of a trial have it."""
    headline: bool = False
    """True: a column beside the rates of success. False: a row in the table of what the person bore."""
    matters: float | None = None
    """Smallest difference between two policies that matters [unit]. Comparisons test the metrics that name one."""
    order: int = 100
    """Place in tables, lowest first; metrics with the same order stand by id."""

    def __post_init__(self) -> None:
        """Raises ConfigError for an id without a version and any other argument of a wrong kind."""
        name, at, version = str(self.id).rpartition("@")
        if not (name and at and version.isdigit()):
            raise ConfigError(f"metric {self.id!r}: the id must be NAME@VERSION, for example {self.id or 'grip'}@1")
        if self.field is not None and self.field not in MEASURED:
            raise ConfigError(
                f"metric {self.id}: TrialScore has no field {self.field!r} that a metric fills; "
                "leave field out and the value stands in TrialScore.additional"
            )
        for what, (is_valid, expected) in FIELDS.items():
            if not is_valid(value := getattr(self, what)):
                raise ConfigError(f"metric {self.id}: {what}: expected {expected}; got {value!r}")
        if self.matters is not None and self.better == "neither":
            raise ConfigError(f"metric {self.id}: matters needs a direction; better must be 'higher' or 'lower'")

    @property
    def name(self) -> str:
        """The id, without its version for the metrics that have a field of their own."""
        return self.id if self.field is None else self.id.partition("@")[0]

    @property
    def label(self) -> str:
        """Name and unit, as the head of a column."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    @property
    def actions(self) -> tuple[str, ...] | None:
        """The actions of ``pool``, by name."""
        return _named(self.pool)

    def concerns(self, action: str) -> bool:
        """Whether the metric says something about trials of an action."""
        actions = _named(self.pool if self.only is None else self.only)
        return actions is None or action in actions

    def compute(self, contact: Contact) -> float | None:
        """Return the number of one trial; None for NA. Raises ConfigError for a measure that returns anything else."""
        return self._number(self._measured(contact))

    def fill(self, contact: Contact) -> dict[str, Any]:
        """Field of ``TrialScore`` -> value, for a metric that has a field. NA fills its own field alone, with None."""
        assert self.field is not None
        found = self._measured(contact)
        return dict(found) if isinstance(found, Mapping) else {self.field: found}

    def of(self, score: TrialScore) -> float | None:
        """Return the number that a score holds; None for NA and where the trial was scored without this metric."""
        return self._number(score.additional.get(self.id) if self.field is None else getattr(score, self.field))

    def pooled(self, scores: Iterable[TrialScore]) -> list[float | None]:
        """Return one number for each of the trials that this metric is pooled over."""
        actions = self.actions
        return [self.of(score) for score in scores if actions is None or score.action in actions]

    def _measured(self, contact: Contact) -> Measured:
        title, trial_id = METRICS.title(self.id), contact.recording.header.spec.trial_id
        with blamed_on(title, trial_id):
            found: object = self.measure(contact)
        if found is None or isinstance(found, Real):
            return found  # pyright: ignore[reportReturnType]
        if self.field is not None and isinstance(found, dict):
            if unknown := found.keys() - set(MEASURED):
                raise ConfigError(f"{title}: no metric fills the field {min(unknown)!r} of TrialScore")
            return found
        raise ConfigError(f"{title} returned {shown(found)} in trial {trial_id}; expected a number, or None for NA")

    def _number(self, found: Measured) -> float | None:
        number = found[str(self.field)] if isinstance(found, Mapping) else found
        return None if number is None else float(number)


def _named(pool: Pool) -> tuple[str, ...] | None:
    return tuple(sorted(actions_that_move())) if pool == "moving" else pool


METRICS: Registry[Metric] = Registry("metric", row=Metric, scan="carecontact.scoring.metrics")

HEADLINE: dict[str, Any] = {"headline": True, "order": 0}
"""Of the metrics of the paper, which stand beside the rates of success."""
Function = TypeVar("Function", bound=Callable[[Contact], Measured])


def metric(id_: str, **description: Any) -> Callable[[Function], Function]:
    """Register a function of a trial's contact as a metric; ``description`` are the other fields of ``Metric``."""

    def register(measure: Function) -> Function:
        METRICS.register(id_, Metric(id=id_, measure=measure, **description), origin=measure)
        return measure

    return register


def checked_metrics() -> list[Metric]:
    """Return every registered metric. Raises ConfigError for one that is faulty or clashes with another."""
    filled: dict[str, str] = {}
    for name, row in METRICS.items():
        title = METRICS.title(name)
        if row.id != name:
            raise ConfigError(f"{title}: its id is {row.id!r}; give its entry point the same name")
        if row.field is not None and filled.setdefault(row.field, name) != name:
            raise ConfigError(f"metric {name}: another metric fills the field {row.field!r} already")
        for action in row.pool if isinstance(row.pool, tuple) else ():
            if action not in ACTIONS:
                raise ConfigError(f"{title}: pool: {UnknownNameError(ACTIONS.kind, action, ACTIONS)}")
    return list(METRICS.values())


def metrics_in_order() -> list[Metric]:
    """Return every registered metric, as tables list them."""
    return sorted(METRICS.values(), key=lambda row: (row.order, row.id))


def newest(ids: Iterable[str]) -> list[str]:
    """Return the highest version of each metric, in the order of their names. An id without a version stays."""
    found: dict[str, tuple[int, str]] = {}
    for id_ in ids:
        name, _, version = id_.partition("@")
        number = int(version) if version.isdigit() else 0
        if number >= found.get(name, (0, ""))[0]:
            found[name] = number, id_
    return [found[name][1] for name in sorted(found)]


def described(id_: str) -> Metric:
    """Return the metric of this id, or a bare row for one that nothing registers here."""
    if id_ in METRICS:
        return METRICS[id_]
    return Metric(id=id_, title=id_, unit="1", better="neither", measure=lambda contact: None)
