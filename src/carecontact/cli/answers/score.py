"""The answer of `carecontact score`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer
from carecontact.cli.answers.summary import Summary


class ScoreAnswer(Answer):
    kind: Annotated[Literal["carecontact-score-1"], Field(alias="schema")] = "carecontact-score-1"
    folder: str
    results: str | None
    """The results.json that was written; null if it stayed as it was."""
    added: list[str] | None
    """Metrics that ``--append`` added; null without this option."""
    skipped: dict[str, str]
    """File that could not be scored -> why."""
    missing: list[str]
    """Planned trials without a score."""
    overall: Summary | None
    """Rates and medians over all trials that could be scored; null if there were none."""
    per_task: dict[str, Summary]
    status: int
    """Exit status of the command."""
