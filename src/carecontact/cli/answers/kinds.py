"""Every kind of line that `--json` prints."""

from __future__ import annotations

from carecontact.cli.answers.answer import Answer
from carecontact.cli.answers.compare import CompareAnswer
from carecontact.cli.answers.doctor import DoctorAnswer
from carecontact.cli.answers.error import ErrorAnswer
from carecontact.cli.answers.names import ListAnswer
from carecontact.cli.answers.protocol import (
    ProtocolFeasibleAnswer,
    ProtocolListAnswer,
    ProtocolLockAnswer,
    ProtocolShowAnswer,
    ProtocolVerifyAnswer,
)
from carecontact.cli.answers.run import RunAnswer, TrialAnswer
from carecontact.cli.answers.score import ScoreAnswer
from carecontact.cli.answers.sweep import SweepAnswer, SweepCellAnswer
from carecontact.cli.answers.validate import ValidateAnswer

ANSWERS: tuple[type[Answer], ...] = (
    ListAnswer,
    DoctorAnswer,
    TrialAnswer,
    RunAnswer,
    ScoreAnswer,
    CompareAnswer,
    SweepAnswer,
    SweepCellAnswer,
    ProtocolListAnswer,
    ProtocolShowAnswer,
    ProtocolVerifyAnswer,
    ProtocolFeasibleAnswer,
    ProtocolLockAnswer,
    ValidateAnswer,
    ErrorAnswer,
)


def name_of(answer: type[Answer]) -> str:
    """Return the value of its field ``schema``, such as ``carecontact-list-1``."""
    return answer.model_fields["kind"].default
