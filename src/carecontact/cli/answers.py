"""What commands print with `--json`: what every answer has in common, and the answers that need no results."""

from __future__ import annotations

from typing import Annotated, Any, Literal, cast

from pydantic import BaseModel, ConfigDict, Field
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import PydanticSerializationError, core_schema, to_json

from carecontact.running.machine import Finding


class Answer(BaseModel):
    """One line of JSON on standard output. The field ``schema`` says which kind of line it is."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", validate_by_name=True, serialize_by_alias=True, use_attribute_docstrings=True
    )

    def line(self) -> str:
        """Return one line of JSON. A number that is not finite becomes null; what is not UTF-8 becomes an escape."""
        try:
            return self.model_dump_json()
        except PydanticSerializationError:
            return to_json(_encodable(self.model_dump()), inf_nan_mode="null").decode()


def _encodable(found: object) -> object:
    if isinstance(found, str):
        return found.encode(errors="backslashreplace").decode()
    if isinstance(found, dict):
        return {_encodable(name): _encodable(value) for name, value in cast("dict[str, object]", found).items()}
    if isinstance(found, list | tuple):
        return [_encodable(value) for value in cast("list[object]", found)]
    return found


class Part(BaseModel):
    """A part of an answer."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Schema(GenerateJsonSchema):
    """JSON Schema 2020-12 in which every number may be null, because JSON has no infinity and no NaN."""

    def float_schema(self, schema: core_schema.FloatSchema) -> JsonSchemaValue:
        return {"type": ["number", "null"]}


def schema_of(answer: type[Answer]) -> dict[str, Any]:
    made = answer.model_json_schema(schema_generator=Schema)
    # ``schema`` has a default in Python only.
    required = sorted({"schema", *made.get("required", [])})
    return {"$schema": Schema.schema_dialect, **made, "required": required}


class ErrorAnswer(Answer):
    """The last line of a command that an error or an interruption ended."""

    kind: Annotated[Literal["carecontact-error-1"], Field(alias="schema")] = "carecontact-error-1"
    error: str
    """Class of the error, such as ConfigError; ``Interrupted`` after Ctrl-C or a polite kill."""
    message: str
    """What people read on standard error."""
    status: int
    """Exit status of the command."""


class Name(Part):
    name: str
    meaning: str
    """Its meaning in words for people; their form may change."""


class ListAnswer(Answer):
    kind: Annotated[Literal["carecontact-list-1"], Field(alias="schema")] = "carecontact-list-1"
    names: dict[str, list[Name]]
    """Kind of names, such as ``tasks`` -> the names of that kind."""


class Listed(Part):
    id: str
    sha256: str
    frozen: bool
    description: str


class ProtocolListAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-list-1"], Field(alias="schema")] = "carecontact-protocol-list-1"
    protocols: list[Listed]


class ProtocolShowAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-show-1"], Field(alias="schema")] = "carecontact-protocol-show-1"
    id: str
    sha256: str
    frozen: bool
    lock: str | None
    """Name of the lock; null if there is none."""
    fields: dict[str, Any]
    """Every field of the protocol, with those that the file inherits or leaves at their defaults."""


class ProtocolVerifyAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-verify-1"], Field(alias="schema")] = "carecontact-protocol-verify-1"
    id: str
    equal: bool
    """Whether the protocol has a lock and equals it."""
    differences: list[str]
    """The differences in words for people; empty if the protocol is equal or has no lock."""


class ProtocolLockAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-lock-1"], Field(alias="schema")] = "carecontact-protocol-lock-1"
    id: str
    lock: str
    """Path of the lock that was written."""


class RejectedPerson(Part):
    """A person who was drawn and rejected, because the robot cannot serve one region on one of the levels."""

    comfort_arm_deg: float
    shoulder_rotation_deg: float
    palm_deg: float
    region: str
    """The region that cannot be served; empty if the person did not come to rest."""
    refused: dict[str, int]
    """Reason -> number of bases that were refused for it."""


class FeasibleSeed(Part):
    seed: int
    salted: bool
    feasible: bool
    body: str | None
    draws: dict[str, int]
    """Region -> number of draws of a base, including the one that serves."""
    refused: dict[str, int]
    """Reason -> number of bases that were refused for it beside the accepted person."""
    rejected: list[RejectedPerson]
    """The persons who were rejected before this one."""


class ProtocolFeasibleAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-feasible-1"], Field(alias="schema")] = (
        "carecontact-protocol-feasible-1"
    )
    id: str
    """Id of the protocol, with its level."""
    feasible: bool
    """Whether every seed is feasible."""
    seeds: list[FeasibleSeed]


class DoctorAnswer(Answer):
    kind: Annotated[Literal["carecontact-doctor-1"], Field(alias="schema")] = "carecontact-doctor-1"
    fine: bool
    """Whether this machine can run trials."""
    findings: list[Finding]


class MeasureAnswer(Part):
    name: str
    value: float | None
    """The measured value; null if it is not finite."""
    unit: str
    limit: float | None = None
    """The limit. This field and those after it are absent if the quantity has no limit."""
    side: Literal["at most", "at least", "below"] | None = None
    decides: bool | None = None
    met: bool | None = None
    known: bool | None = None
    """Whether this person is known to miss this limit. Missing it fails the check all the same."""


class CheckAnswer(Part):
    check: str
    title: str
    passed: bool
    error: str | None
    """Why the check could not be finished; null if it was."""
    measures: list[MeasureAnswer]


class BodyAnswer(Part):
    body: str
    passed: bool
    record: str
    """Path of its validation.json."""
    checks: list[CheckAnswer]


class ValidateAnswer(Answer):
    kind: Annotated[Literal["carecontact-validate-1"], Field(alias="schema")] = "carecontact-validate-1"
    passed: bool
    """Whether every check passed on every body."""
    bodies: list[BodyAnswer]
