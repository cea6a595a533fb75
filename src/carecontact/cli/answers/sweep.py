"""The answer of `carecontact sweep`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer
from carecontact.reports.sweep.factors import Factors
from carecontact.reports.sweep.gate_orders import GateOrder
from carecontact.reports.sweep.ladder import Ladder
from carecontact.reports.sweep.stability import Stability


class SweepAnswer(Answer):
    """What the page says above its cells, whose rows sweep.csv has. Rates and their differences are fractions."""

    kind: Annotated[Literal["carecontact-sweep-1"], Field(alias="schema")] = "carecontact-sweep-1"
    title: str
    axes: tuple[str, ...]
    policies: tuple[str, ...]
    rank_by: str
    trials: int
    """Finished and scored, of all cells."""
    planned: int
    stability: Stability | None
    """Whether the order of the policies holds; null where there is none."""
    ladder: Ladder | None
    """Success over the protocols of the plan; null where it has one."""
    factors: Factors | None
    """One factor at a time; null where the plan has no factors."""
    gate_orders: tuple[GateOrder, ...]
    """The order of the policies under other gates."""
