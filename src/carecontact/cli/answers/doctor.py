"""The answer of `carecontact doctor`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer
from carecontact.trials.machine import Finding


class DoctorAnswer(Answer):
    kind: Annotated[Literal["carecontact-doctor-1"], Field(alias="schema")] = "carecontact-doctor-1"
    fine: bool
    """Whether this machine can run trials."""
    findings: list[Finding]
