"""The answer of `carecontact validate`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer, Part


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
