"""The answer of `carecontact list`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer, Part


class Name(Part):
    name: str
    meaning: str
    """Its meaning in words for people; their form may change."""


class ListAnswer(Answer):
    kind: Annotated[Literal["carecontact-list-1"], Field(alias="schema")] = "carecontact-list-1"
    names: dict[str, list[Name]]
    """Kind of names, such as ``tasks`` -> the names of that kind."""
