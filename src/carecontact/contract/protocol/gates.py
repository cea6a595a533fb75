"""What a trial has to achieve: one table for each action, in the schema that the action's behaviour declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol, Self, cast, runtime_checkable

from pydantic import BeforeValidator, ConfigDict, SerializerFunctionWrapHandler, model_serializer, model_validator

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

    def under(self, version: str) -> HasGate:
        """Return the row that judges the action where ``gates.version`` is this."""
        ...


BEHAVIOURS: Registry[HasGate] = Registry(
    "action", row=HasGate, expected="a Behaviour object", plural="behaviours", scan="carecontact.behaviours"
)
"""Action -> its behaviour. Other packages add rows through the entry-point group ``carecontact.behaviours``."""


def _gate(named: tuple[str, str, object]) -> Section:
    """Return the table of one action, by the action's own schema under the gates' version; its errors keep their place
    in the file."""
    version, action, table = named
    try:
        return BEHAVIOURS[action].under(version).gate.model_validate(table)
    except UnknownNameError as error:
        raise ValueError(str(error)) from None


class Gates(Section):
    """Every field besides those named here is an action with the table of its behaviour: ``gates.push.force_n``."""

    model_config = ConfigDict(extra="allow")
    # Pydantic takes the type of extra fields from this annotation.
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(_gate)]]  # pyright: ignore[reportIncompatibleVariableOverride]

    version: Literal["gates-v1", "gates-v2"]
    """The second judges the person's joints too, needs both of their fields, and has other tables for touch, push and
    scrub: how gently they have to be done (``behaviours``)."""
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
        """Hand each action's table on with the version and its name, by which ``_gate`` finds the schema."""
        if not isinstance(content, Mapping):
            return content
        tables = cast("Mapping[str, object]", content)
        version = str(tables.get("version"))
        return {name: table if name in cls.model_fields else (version, name, table) for name, table in tables.items()}

    @model_serializer(mode="wrap")
    def _share_last(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields in the order in which protocols have always been written."""
        content = handler(self)
        last = {name: content.pop(name) for name in ("region_share", "joint_beyond_rad", "joint_consumed")}
        return {**content, **{name: value for name, value in last.items() if value is not None}}

    @model_validator(mode="after")
    def _joints_from_version_2_on(self) -> Self:
        fields = (self.joint_beyond_rad, self.joint_consumed)
        if any((value is None) == (self.version == "gates-v2") for value in fields):
            raise ValueError("joint_beyond_rad and joint_consumed belong to gates-v2, which needs both")
        return self
