"""What a part of the audit returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Finding:
    policy: str
    place: str
    """The value that leaks, such as ``observation.cameras.overhead.landmarks`` or ``session.time_limit_s``."""
    told: str


@dataclass(frozen=True, kw_only=True)
class Part:
    name: str
    title: str
    counts: dict[str, int]
    """What was examined, and how often. A part that examined nothing has shown nothing, and fails."""
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()
    """What the part measured without judging it."""
    nothing_to_examine: bool = False
    """Whether nothing was there that could have shown a leak. This is no fault, so the part does not fail."""

    @property
    def passed(self) -> bool:
        return not self.findings and bool(self.counts) and all(self.counts.values())

    @property
    def missing(self) -> list[str]:
        """Return what the part should have examined and did not."""
        return [what for what, count in self.counts.items() if not count]

    def as_json(self) -> dict[str, Any]:
        return {
            "part": self.name, "title": self.title, "passed": self.passed, "counts": self.counts,
            "findings": [{"policy": f.policy, "place": f.place, "told": f.told} for f in self.findings],
        }  # fmt: skip
