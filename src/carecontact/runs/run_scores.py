"""The scores of one run, from whatever they were read or computed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from carecontact.runs.pooling import incomplete, judged, unjudged
from carecontact.scoring.result import TrialScore


@dataclass(frozen=True, kw_only=True)
class RunScores:
    scores: list[TrialScore]
    """The scores in the order of the file names."""
    skipped: dict[str, str] = field(default_factory=dict[str, str])
    """File name -> why it was not scored."""
    versions: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Package -> every version that the scored recordings name, and those of the packages whose metrics scored them;
    more than one means a mixed run."""
    missing: tuple[str, ...] = ()
    """Trials that were planned and have no score; where no plan is known, none."""
    elsewhere: tuple[str, ...] = ()
    """Trials of the other parts of the run of which this is a part (``run --shard``)."""

    @cached_property
    def unjudged(self) -> dict[str, str]:
        """Planned trial -> why it has no verdict; empty for a complete run."""
        return unjudged(self.scores, skipped=self.skipped, missing=self.missing, elsewhere=self.elsewhere)

    @property
    def incomplete(self) -> str:
        """``incomplete, 15 of 18 planned trials have a verdict``; empty for a complete run."""
        return incomplete(len(judged(self.scores)), self.unjudged)

    @property
    def completing(self) -> str:
        """What makes an incomplete run complete, as a part of a sentence."""
        parts = all(trial in self.elsewhere for trial in self.unjudged)
        return "join its parts with `carecontact merge`" if parts else "give its `carecontact run` command again"
