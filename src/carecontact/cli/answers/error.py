"""The answer of a command that could not do its work."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer


class ErrorAnswer(Answer):
    """The last line of a command that an error or an interruption ended."""

    kind: Annotated[Literal["carecontact-error-1"], Field(alias="schema")] = "carecontact-error-1"
    error: str
    """Class of the error, such as ConfigError; ``Interrupted`` after Ctrl-C or a polite kill."""
    message: str
    """What people read on standard error."""
    status: int
    """Exit status of the command."""
