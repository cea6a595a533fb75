"""The answers of `carecontact run`: a line for each trial, and one at the end."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer, Part
from carecontact.cli.answers.summary import Summary
from carecontact.recording.schema import EndReason
from carecontact.scoring.result import TrialScore


class TrialAnswer(Answer):
    """A trial that has ended, or that an earlier command had finished. If scoring then finds the recording of such an
    earlier trial damaged, the trial runs again and gets a second line."""

    kind: Annotated[Literal["carecontact-run-trial-1"], Field(alias="schema")] = "carecontact-run-trial-1"
    trial_id: str
    ended: EndReason
    kept: bool
    """Whether an earlier command ran it."""
    done: int
    """Number of trials that need no more work, this one included."""
    total: int
    message: str | None
    """Why the trial failed, in one line; null for a trial that did not."""
    score: TrialScore | None
    """The score; null for a trial that an earlier command ran and for one that cannot be scored."""


class RunProtocol(Part):
    id: str
    sha256: str
    overrides: dict[str, str]
    """Field -> the value that an option set."""


class RunAnswer(Answer):
    """The last line of a run that came to its end."""

    kind: Annotated[Literal["carecontact-run-1"], Field(alias="schema")] = "carecontact-run-1"
    folder: str
    policy: str
    protocol: RunProtocol
    ended: dict[str, EndReason]
    """Every planned trial that has a recording -> how it ended."""
    ran: list[str]
    """Trials that this command ran."""
    kept: list[str]
    """Trials that an earlier command had finished."""
    late: dict[str, int]
    """Trial -> number of observations that were late for ``--pace``."""
    skipped: dict[str, str]
    """File that could not be scored -> why."""
    overall: Summary | None
    """Rates and medians over all trials; null if nothing could be scored."""
    status: int
    """Exit status of the command."""
