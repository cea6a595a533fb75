"""One line of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warning", "error", "hint", "wait"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    level: Level
    topic: str
    text: str
    """Text, whose first line stands beside level and topic, and whose other lines stand below it."""
