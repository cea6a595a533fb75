"""What a task asks for and when it is done: actions with their gates, tasks, and what counts as contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal, Protocol, Self, cast, runtime_checkable

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


def registered(registry: Registry[Any]) -> Callable[[str], str]:
    """Return a validator that passes the names of a registry's rows; the error of any other name lists them."""

    def check(name: str) -> str:
        if name not in registry:
            raise ValueError(str(UnknownNameError(registry.kind, name, registry)))
        return name

    return check


# What a trial has to achieve: one table for each action, in the schema that the action's behaviour declares.


@runtime_checkable
class HasGate(Protocol):
    """What a protocol needs of a row of BEHAVIOURS; the rest of a row is for the scorer (``scoring.behaviour``)."""

    @property
    def gate(self) -> type[Section]:
        """Schema of the table ``[gates.<action>]``."""
        ...

    def under(self, gates: str) -> HasGate:
        """Return the row that judges the action where ``gates.set`` is this."""
        ...


BEHAVIOURS: Registry[HasGate] = Registry(
    "action", row=HasGate, expected="a Behaviour object", plural="behaviours", scan="carecontact.scoring.actions"
)
"""Action -> its behaviour. Other packages add rows through the entry-point group ``carecontact.behaviours``."""


def _gate(named: tuple[str, str, object]) -> Section:
    """Return the table of one action, by the action's own schema in the set of gates; its errors keep their place in
    the file."""
    gates, action, table = named
    try:
        return BEHAVIOURS[action].under(gates).gate.model_validate(table)
    except UnknownNameError as error:
        raise ValueError(str(error)) from None


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
    def _joints_in_the_exam(self) -> Self:
        fields = (self.joint_beyond_rad, self.joint_consumed)
        if any((value is None) == (self.set == "exam") for value in fields):
            raise ValueError("joint_beyond_rad and joint_consumed belong to the exam's gates, which need both")
        return self


# A task: one action on one region, and the sentence that a policy is given.

ActionName = Annotated[str, AfterValidator(registered(BEHAVIOURS))]
"""Name of a row of BEHAVIOURS."""
RegionName = Annotated[str, AfterValidator(registered(REGIONS))]
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


def _segment(name: str) -> str:
    if name not in SEGMENTS:
        raise ValueError(f"no segment named {name!r}; valid: {', '.join(SEGMENTS)}")
    return name


SegmentName = Annotated[str, AfterValidator(_segment)]
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
