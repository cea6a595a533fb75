"""What a task asks for and when it is done: actions with their gates, tasks, and what counts as contact."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Container, Mapping, Sequence
from typing import Annotated, Any, Literal, Self, cast

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from carecontact.errors import UnknownNameError
from carecontact.interface.regions import REGIONS, SEGMENTS, STANDARD_REGIONS
from carecontact.registry import Registry

# The base of every table of a protocol, and the kinds of number that its fields share.

Positive = Annotated[float, Field(gt=0)]
Length = Annotated[float, Field(ge=0.001, le=0.2)]
"""[m] of something in a person's tissue; the range reports millimetres that were given for metres."""
Fraction = Annotated[float, Field(ge=0, le=1)]
Vec3 = tuple[float, float, float]
FileStem = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=64)]
"""An id that becomes part of a file's name, so it cannot point to another folder."""


class Section(BaseModel):
    """A table of a protocol file: frozen, without unknown fields, every number finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def absent(value: object) -> bool:
    """Whether an optional section is absent: it is then neither written nor hashed, so that older hashes stay."""
    return value is None


def registered(registry: Registry[Any]) -> AfterValidator:
    """Passes the names of a registry's rows; the error of any other name lists them."""
    return named(registry, lambda name: str(UnknownNameError(registry.kind, name, registry)))


def one_of(kind: str, valid: Collection[str]) -> AfterValidator:
    return named(valid, lambda name: f"no {kind} named {name!r}; valid: {', '.join(valid)}")


def named(valid: Container[str], refusal: Callable[[str], str]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in valid:
            raise ValueError(refusal(name))
        return name

    return AfterValidator(check)


def below(low: str, high: str) -> Any:
    """A validator of a table whose field ``low`` has to be below ``high``."""

    def check(table: Any) -> Any:
        least, most = getattr(table, low), getattr(table, high)
        if least >= most:
            raise ValueError(f"{low} {least:g} has to be below {high} {most:g}")
        return table

    return model_validator(mode="after")(check)


# What a trial has to achieve: one table for each action. The rules that judge a trial by it are in ``scoring.actions``;
# docs/evidence/scores.md has the reasons and sources of the values in the shipped protocols.


class TouchGate(Section):
    duration_s: Positive
    """Least time of uninterrupted contact [s]."""


class ForceBand(Section):
    """The range in which a gate requires the held force (``scoring.contact.held_force``) to be."""

    least_n: Positive
    most_n: Positive
    _ordered = below("least_n", "most_n")


class GentleTouchGate(ForceBand):
    duration_s: Positive
    """Least time of uninterrupted contact with the force in the band [s]."""


class PressGate(Section):
    force_n: Positive
    """Least force, summed over the named region's segment and its neighbours, during the whole hold [N]."""
    duration_s: Positive


class PushGate(PressGate):
    wrist_displacement_m: Positive
    """Least horizontal displacement of the wrist from where it rested before the trial [m]."""


class PushFromOnsetGate(PressGate):
    least_wrist_m: Positive
    """Least horizontal displacement of the wrist from where it was when the contact episode began [m]."""
    most_wrist_m: Positive
    _ordered = below("least_wrist_m", "most_wrist_m")


class ScrubGate(Section):
    on_share: Fraction
    """Least share of an episode's time that is in contact."""
    stroke_m: Positive
    """Least length of the tool's path over the skin while in contact [m]."""
    extent_m: Positive
    """Least length of the part of the region's axis that this path covers [m]."""
    reversals: int


class ScrubPassesGate(ForceBand):
    passed_m: Positive
    """Least length of the part of the region's axis that is passed ``passes`` times with at least ``least_n`` [m]."""
    passes: Annotated[int, Field(ge=1)]
    band_share: Fraction
    """Least share of the sliding time in which the force is in the band."""


GATES: dict[str, dict[str, type[Section]]] = {
    "touch": {"paper": TouchGate, "exam": GentleTouchGate},
    "push": {"paper": PushGate, "exam": PushFromOnsetGate},
    "scrub": {"paper": ScrubGate, "exam": ScrubPassesGate},
}
"""Shipped action -> ``gates.set`` -> schema of the table ``[gates.<action>]``."""


# What a trial owes the person besides its task (``scoring.metrics.success``). Any set of gates may have it.


class Conduct(Section):
    """How gentle a trial of one action has to be from first touch to last, and that the tool does the work: every limit
    is on the whole trial, and on the whole person where it names no place."""

    peak_n: Positive
    """No segment ever bears more [N]."""
    above_n: Positive | None = None
    """A larger force on any segment is above the band [N]; ``above_s`` limits its time."""
    above_s: Annotated[float | None, Field(ge=0)] = None
    """Longest time above the band, in all [s]."""
    band_n: tuple[Positive, Positive] | None = None
    """Range in which the held force (``scoring.contact.held_force``) has to be for ``band_s`` [N]."""
    band_s: Positive | None = None
    """Least time in ``band_n``, in all [s]."""
    comfortable_share: Fraction | None = None
    """Least share of the time in contact with a comfortable mean pressure under the tool (``cells.COMFORT_MMHG``)."""
    tool_share: Fraction | None = None
    """Least share of the contact impulse that the tool applies."""
    beside_n: Annotated[float | None, Field(ge=0)] = None
    """Largest force of the robot's hand and links together on any segment [N]."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for pair in (("above_n", "above_s"), ("band_n", "band_s")):
            if (getattr(self, pair[0]) is None) != (getattr(self, pair[1]) is None):
                raise ValueError(f"{' and '.join(pair)} belong together: give both or none")
        if self.above_n is not None and self.above_n >= self.peak_n:
            raise ValueError(f"above_n {self.above_n:g} has to be below peak_n {self.peak_n:g}")
        if self.band_n is not None and not self.band_n[0] < self.band_n[1] <= self.peak_n:
            raise ValueError(f"band_n: expected [least, most] with least < most <= peak_n, got {list(self.band_n)}")
        return self


class Action(ABC):
    @abstractmethod
    def gate_in(self, gates: str) -> type[Section]:
        """Return the schema of the table ``[gates.<action>]`` where ``gates.set`` is this."""


class ShippedAction(Action):
    def __init__(self, schemas: Mapping[str, type[Section]]) -> None:
        self.schemas = schemas

    def gate_in(self, gates: str) -> type[Section]:
        return self.schemas.get(gates, self.schemas["paper"])


ACTIONS: Registry[Action] = Registry("action", row=Action, expected="a Behaviour object", plural="behaviours")
"""The actions that a task can name. Other packages add rows through the entry-point group ``carecontact.behaviours``:
objects of ``scoring.behaviour.Behaviour``, which are loaded only for a protocol that names them."""
for _name, _schemas in GATES.items():
    ACTIONS.register(_name, ShippedAction(_schemas))


def _gate(named: tuple[str, str, object]) -> Section:
    """Return an action's table by its schema in the set of gates; errors keep their place in the file."""
    gates, action, table = named
    try:
        return ACTIONS[action].gate_in(gates).model_validate(table)
    except UnknownNameError as error:
        raise ValueError(str(error)) from None


class FoamGate(Section):
    """What a task with foam asks for besides its action's own gate (``scoring.foam``)."""

    cleaned_share: Fraction
    """A scrub cleans at least this share of the foam's area: it takes the place of the length that a scrub passes."""
    within_m: Positive
    """Any other action acts at the foam: the tool's middle is within this distance of the foam's along the skin [m]"""
    impulse_share: Fraction
    """for at least this share of the contact impulse."""


class Gates(Section):
    """Every field besides those named here is an action with the table of its behaviour: ``gates.push.force_n``."""

    model_config = ConfigDict(extra="allow")
    # Pydantic takes the type of extra fields from this annotation.
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(_gate)]]  # pyright: ignore[reportIncompatibleVariableOverride]

    set: Literal["paper", "exam"]
    """``paper`` has the gates of the paper. ``exam`` judges the person's joints too, for which it needs both fields,
    and has other tables for touch, push and scrub: how gently they have to be done (``behaviours``)."""
    region_share: Fraction
    """Region-correct: C3 and at least this share of contact impulse on the named region."""
    joint_beyond_rad: Positive | None = None
    """A trial in which a scored joint went farther beyond its range is not safety-gated. Ranges of motion are read to
    about 5 degrees, so a limit below that judges the goniometer."""
    joint_consumed: Fraction | None = None
    """A joint that used up more than this share of its settled margin is flagged; it fails no trial."""
    conduct: dict[str, Conduct] | None = Field(default=None, exclude_if=absent)
    """Action -> what its trials owe the person besides the task. An action without a row has its own table alone."""
    foam: FoamGate | None = Field(default=None, exclude_if=absent)
    """For tasks on whose region the protocol puts foam; those without foam are judged by their actions alone."""

    def of(self, action: str) -> Section:
        """Return the table of an action. Raises UnknownNameError, which lists the actions that have one."""
        gates = self.actions
        if action not in gates:
            raise UnknownNameError("gate", action, gates)
        return gates[action]

    @property
    def actions(self) -> Mapping[str, Section]:
        """Action -> its table, in the order of the file."""
        return cast("dict[str, Section]", self.model_extra)

    @model_validator(mode="before")
    @classmethod
    def _with_names(cls, content: object) -> object:
        """Hand each action's table on with the set and its name, by which ``_gate`` finds the schema."""
        if not isinstance(content, Mapping):
            return content
        tables = cast("Mapping[str, object]", content)
        gates = str(tables.get("set"))
        return {name: table if name in cls.model_fields else (gates, name, table) for name, table in tables.items()}

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for action in self.conduct or {}:
            if action not in self.actions:
                raise ValueError(f"conduct.{action}: no table of this action; valid: {', '.join(self.actions)}")
        fields = (self.joint_beyond_rad, self.joint_consumed)
        if any((value is None) == (self.set == "exam") for value in fields):
            raise ValueError("joint_beyond_rad and joint_consumed belong to the exam's gates, which need both")
        return self


# A task: one action on one region, and the sentence that a policy is given.

ActionName = Annotated[str, registered(ACTIONS)]
"""Name of a row of ACTIONS."""
RegionName = Annotated[str, registered(REGIONS)]
"""Name of a row of ``carecontact.interface.regions.REGIONS``."""


class Task(Section):
    id: FileStem
    name: str
    action: ActionName
    region: RegionName
    prompt: str


def regions_of(tasks: Sequence[Task]) -> tuple[str, ...]:
    """Return the standard regions, then whatever else the tasks name, in the order of the tasks."""
    return tuple(dict.fromkeys((*STANDARD_REGIONS, *(task.region for task in tasks))))


# When a segment counts as touched, and where success may be earned.


SegmentName = Annotated[str, one_of("segment", SEGMENTS)]
"""One of ``carecontact.interface.regions.SEGMENTS``."""


class ContactDefinition(Section):
    version: Literal["contact-v1"]
    on_n: Positive
    off_n: Positive
    filter_hz: Positive
    filter_order: Literal[2]
    valid_total_s: Positive
    episode_gap_s: Positive
    stroke_sample_hz: Positive
    stroke_filter_hz: Positive
    reversal_m: Positive
    active_speed_m_s: Positive
    active_rotation_rad_s: Positive
    peak_filter_hz: Positive
    neighbourhood: dict[RegionName, Annotated[list[SegmentName], Field(min_length=1)]]
    """Region -> segments on which C3 may be earned."""
