"""The answer of `carecontact compare`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer
from carecontact.reports.compare.baselines import Baselines
from carecontact.reports.compare.comparison import Comparison
from carecontact.reports.compare.overview import Overview


class CompareAnswer(Answer):
    """Rates and their differences are fractions. Differences are A minus B."""

    kind: Annotated[Literal["carecontact-compare-1"], Field(alias="schema")] = "carecontact-compare-1"
    alpha: float
    """Level of the whole family of tests."""
    power: float
    """Power at which the smallest detectable difference is given."""
    comparison: Comparison | None
    """The comparison of two runs; null for one run or more than two."""
    overview: Overview | None
    """The overview of more than two runs; else null."""
    baselines: dict[str, Baselines]
    """Letter of a run -> the blind baselines beside it; empty without ``--baseline``."""
