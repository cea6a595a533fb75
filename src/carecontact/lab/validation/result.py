"""The result of a check: measured quantities, the limits that decide, and the curves of its figure."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal, SupportsFloat

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.figure import Figure
else:
    Figure = Any  # matplotlib is optional

Array = npt.NDArray[np.float64]
Side = Literal["at most", "at least", "below"]


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One measured quantity; one with a limit passes or fails."""

    name: str
    value: float
    unit: str = ""
    limit: float | None = None
    side: Side = "at most"
    decides: bool = True
    """Whether the limit decides. If not, it is shown, but missing it does not fail the check."""

    @property
    def met(self) -> bool | None:
        """Whether the limit is met; None without a limit. A value that is not finite never meets one."""
        if self.limit is None:
            return None
        holds = {"at most": operator.le, "at least": operator.ge, "below": operator.lt}[self.side]
        return isfinite(self.value) and holds(self.value, self.limit)

    def as_json(self) -> dict[str, Any]:
        """Return the measure with six digits; further digits are rounding of the platform and no measurement."""
        value = float(f"{self.value:.6g}") if isfinite(self.value) else None
        out: dict[str, Any] = {"name": self.name, "value": value, "unit": self.unit}
        if self.limit is not None:
            out |= {"limit": self.limit, "side": self.side, "decides": self.decides, "met": self.met}
        return out


def measured(
    name: str, value: SupportsFloat, unit: str = "", *, at_most: float | None = None, at_least: float | None = None,
    below: float | None = None, decides: bool = True,
) -> Measure:  # fmt: skip
    limits: tuple[tuple[Side, float | None], ...] = (("at least", at_least), ("below", below))
    side, limit = next((pair for pair in limits if pair[1] is not None), ("at most", at_most))
    return Measure(name=name, value=float(value), unit=unit, limit=limit, side=side, decides=decides)


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    check: str
    """Name of the check on the command line."""
    title: str
    measures: tuple[Measure, ...]
    curves: Mapping[str, Array] = field(default_factory=dict)
    """The curves of the figure, by name; the check's own ``draw`` knows their shapes."""
    error: str | None = None
    """Why the check could not be finished, and therefore failed; None if it was finished."""

    @property
    def passed(self) -> bool:
        """Whether the check was finished, has a deciding limit, and meets every such limit."""
        deciding = [m for m in self.measures if m.limit is not None and m.decides]
        return self.error is None and bool(deciding) and all(m.met for m in deciding)

    @property
    def missed(self) -> list[Measure]:
        return [m for m in self.measures if m.decides and m.met is False]

    def regions(self, curve: str) -> list[str]:
        """Return the regions that have such a curve, named ``<region>/<curve>``, in the order of the check."""
        return [region for region, _, name in (key.partition("/") for key in self.curves) if name == curve]

    def value(self, name: str) -> float:
        """Return the value of a measure. Raises KeyError for an unknown name; its message lists the names."""
        values = {m.name: m.value for m in self.measures}
        if name not in values:
            raise KeyError(f"no measure {name!r}; there are: {', '.join(values)}")
        return values[name]

    def as_json(self) -> dict[str, Any]:
        head = {"check": self.check, "title": self.title, "passed": self.passed, "error": self.error}
        return {**head, "measures": [m.as_json() for m in self.measures]}
