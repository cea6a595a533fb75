"""The base of every table of a protocol, and the kinds of number that its fields share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from carecontact.errors import UnknownNameError
from carecontact.registry import Registry

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
