"""What every answer has in common."""

from __future__ import annotations

from typing import Any, cast

from pydantic import BaseModel, ConfigDict
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import PydanticSerializationError, core_schema, to_json


class Answer(BaseModel):
    """One line of JSON on standard output. The field ``schema`` says which kind of line it is."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", validate_by_name=True, serialize_by_alias=True, use_attribute_docstrings=True
    )

    def line(self) -> str:
        """Return the answer as JSON without a line break. A number that is not finite becomes null; of a file's name,
        what is not UTF-8 becomes an escape such as ``\\udcff``.
        """
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
    """Return the JSON Schema of one kind of line."""
    made = answer.model_json_schema(schema_generator=Schema)
    # ``schema`` has a default in Python only.
    required = sorted({"schema", *made.get("required", [])})
    return {"$schema": Schema.schema_dialect, **made, "required": required}
