"""The answers of `carecontact sweep`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer
from carecontact.reports.sweep.factors import Factors
from carecontact.reports.sweep.gate_orders import GateOrder
from carecontact.reports.sweep.ladder import Ladder
from carecontact.reports.sweep.stability import Stability


class SweepCellAnswer(Answer):
    """One cell of a plan, with `--dry-run`."""

    kind: Annotated[Literal["carecontact-sweep-cell-1"], Field(alias="schema")] = "carecontact-sweep-cell-1"
    policy: str
    """Its label in the tables."""
    values: dict[str, str]
    """Axis -> value."""
    folder: str
    """Where its run is or will be."""
    trials: int
    """Number of planned trials."""
    recorded: int
    """How many of them are recorded."""


class SweepAnswer(Answer):
    """The statements of the page about all cells; sweep.csv has the rows of the cells. Rates and differences are
    fractions.
    """

    kind: Annotated[Literal["carecontact-sweep-1"], Field(alias="schema")] = "carecontact-sweep-1"
    title: str
    axes: tuple[str, ...]
    policies: tuple[str, ...]
    rank_by: str
    trials: int
    """Number of finished and scored trials in all cells."""
    planned: int
    stability: Stability | None
    """Whether the order of the policies holds; null if there is no order."""
    ladder: Ladder | None
    """Success over the protocols of the plan; null if it has only one."""
    factors: Factors | None
    """The effect of each factor alone; null if the plan has no factors."""
    gate_orders: tuple[GateOrder, ...]
    """The order of the policies under other gates."""
