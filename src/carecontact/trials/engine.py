"""What an engine is: it carries out the trials of one run, and the supervisor decides which and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from carecontact.contract.trial import TrialSpec
from carecontact.recording.schema import Recording

EngineName = Literal["local", "ray"]
"""On this machine (``trials.workers``), or on the nodes of a Ray cluster (``trials.ray_engine``)."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """An attempt at a trial that has ended."""

    spec: TrialSpec
    recording: Recording | None
    """None: the trial has to run once more, or it did not begin."""
    warnings: tuple[str, ...] | None = None
    """About the policy's first answer; None: it gave none."""
    unreached: str | None = None
    """Why no trial can begin: the policy's server could not be reached, or a package is missing."""
    unstored: bool = False
    """Whether there was no space for the recording."""
    lost: str | None = None
    """How its process or its node died, if it has to run once more."""


class Engine(Protocol):
    """The trials of one run that run now. One thread calls it; no call waits for a trial."""

    def slots(self) -> int:
        """Return how many trials it can run at once, just now."""
        ...

    def count(self) -> int:
        """Return how many trials have started and not ended."""
        ...

    def has_room(self) -> bool:
        """Return whether one more recording can be stored beside those of the trials that run."""
        ...

    def start(self, spec: TrialSpec) -> None: ...

    def finished(self) -> list[Ended]:
        """Take the attempts that have ended; their recordings are then in the run's folder."""
        ...

    def waiting(self) -> dict[str, str]:
        """Trial id -> a line about a policy that was silent just now; empty where an engine cannot know."""
        ...

    def kill_all(self) -> None:
        """Leave no process of any trial behind."""
        ...
