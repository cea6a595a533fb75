"""What a metric is, and the table of all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from carecontact.registry import Registry
from carecontact.scoring.contact import Contact


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One registry row. A change of definition is a new id (``C1@2``), never a change of an old one."""

    id: str
    title: str
    unit: str
    better: Literal["higher", "lower", "neither"]
    compute: Callable[[Contact], float | None]
    """Pure; None means NA. A metric that is never NA answers 0 instead."""


METRICS: Registry[Metric] = Registry("metric")
