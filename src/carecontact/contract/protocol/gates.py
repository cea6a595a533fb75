"""What a trial has to achieve: one table for each action, in the schema that the action's behaviour declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol, cast, runtime_checkable

from pydantic import BeforeValidator, ConfigDict, SerializerFunctionWrapHandler, model_serializer, model_validator

from carecontact.contract.protocol.section import Fraction, Section
from carecontact.errors import UnknownNameError
from carecontact.registry import Registry


@runtime_checkable
class HasGate(Protocol):
    """What a protocol needs of a row of BEHAVIOURS; the rest of a row is for the scorer (``scoring.behaviour``)."""

    @property
    def gate(self) -> type[Section]:
        """Schema of the table ``[gates.<action>]``."""
        ...


BEHAVIOURS: Registry[HasGate] = Registry(
    "action", row=HasGate, expected="a Behaviour object", plural="behaviours", scan="carecontact.behaviours"
)
"""Action -> its behaviour. Other packages add rows through the entry-point group ``carecontact.behaviours``."""


def _gate(named: tuple[str, object]) -> Section:
    """The table of one action, by the action's own schema; its errors keep their place in the file."""
    action, table = named
    try:
        return BEHAVIOURS[action].gate.model_validate(table)
    except UnknownNameError as error:
        raise ValueError(str(error)) from None


class Gates(Section):
    """Every field besides those named here is an action with the table of its behaviour: ``gates.push.force_n``."""

    model_config = ConfigDict(extra="allow")
    # Pydantic takes the type of extra fields from this annotation.
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(_gate)]]  # pyright: ignore[reportIncompatibleVariableOverride]

    version: Literal["gates-v1"]
    region_share: Fraction
    """Region-correct: C3 and at least this share of contact impulse on the named region."""

    def of(self, action: str) -> Section:
        """The table of an action. Raises UnknownNameError, which lists the actions that have one."""
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
        """Hand each action's table on with its name, by which ``_gate`` finds the schema."""
        if not isinstance(content, Mapping):
            return content
        tables = cast("Mapping[str, object]", content)
        return {name: table if name in cls.model_fields else (name, table) for name, table in tables.items()}

    @model_serializer(mode="wrap")
    def _share_last(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """In the order that a protocol has always been written in."""
        content = handler(self)
        share = content.pop("region_share")
        return {**content, "region_share": share}
