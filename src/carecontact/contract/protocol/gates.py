"""What a trial has to achieve: one table for each action, in the schema that the action's behaviour declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol, Self, cast, runtime_checkable

from pydantic import BeforeValidator, ConfigDict, model_validator

from carecontact.contract.protocol.section import Fraction, Positive, Section
from carecontact.errors import UnknownNameError
from carecontact.registry import Registry


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
    "action", row=HasGate, expected="a Behaviour object", plural="behaviours", scan="carecontact.behaviours"
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
