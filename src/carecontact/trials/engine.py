"""The interface of an engine. An engine carries out the trials of one run; the supervisor decides which trials, and
when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from carecontact.contract.trial import TrialSpec
from carecontact.recording.schema import Recording

EngineName = Literal["local", "ray"]
"""``local``: this machine (``trials.workers``); ``ray``: the nodes of a Ray cluster (``trials.ray_engine``)."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """An attempt at a trial that has ended."""

    spec: TrialSpec
    recording: Recording | None
    """None: the trial has to run once more, or it did not begin."""
    warnings: tuple[str, ...] | None = None
    """Warnings about the policy's first answer; None if it gave no answer."""
    unreached: str | None = None
    """Why no trial can begin: the policy's server could not be reached, or a package is missing."""
    unstored: str | None = None
    """Where there was no space for what the trial stores, and what to do; None: there was space."""
    lacked: str | None = None
    """Why the trial could not begin, if it got no process, thread or memory; it may be able to later."""
    lost: str | None = None
    """How the process or the node of the trial died, if the trial has to run once more; else empty."""


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
        """Return the attempts that have ended since the last call. Their recordings are then in the run's folder."""
        ...

    def waiting(self) -> dict[str, str]:
        """Trial id -> a line about a policy that was silent just now; empty where an engine cannot know."""
        ...

    def kill_all(self) -> None:
        """Kill all processes of all trials."""
        ...
