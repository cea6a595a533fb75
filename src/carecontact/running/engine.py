"""What an engine that runs trials has to do, what a worker is asked for, and the pipe on which it reports its
status."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, Self

from pydantic import BaseModel, ConfigDict, model_validator

from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.serving.conversation import PolicySetup

# Messages of a trial's process to its supervisor, through a pipe, which works even if the disk is full.

POLICY_RUNS, POLICY_GONE, ANSWERED = b"+", b"-", b"="
"""The process of a local policy is about to start; it is gone; it answered, and DIGEST_BYTES follow."""
DIGEST_BYTES = 32


class StatusPipe:
    """The supervisor's end of the pipe."""

    def __init__(self, pipe: int) -> None:
        """``pipe``: file descriptor to read from, which this object then owns."""
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self._rest = b""
        self.policy_runs = False
        self.answers = b""
        """Digests of the policy's answers, one after another."""

    def read(self) -> None:
        """Read the messages that have arrived. Call it repeatedly: the other end waits while the pipe is full."""
        with suppress(BlockingIOError):
            while piece := os.read(self._pipe, 1 << 16):
                self._rest += piece
        while self._rest:
            kind, size = self._rest[:1], 1
            if kind == ANSWERED:
                size += DIGEST_BYTES
                if len(self._rest) < size:
                    return
                self.answers += self._rest[1:size]
            else:
                self.policy_runs = kind == POLICY_RUNS
            self._rest = self._rest[size:]

    def close(self) -> None:
        os.close(self._pipe)


# The request of the supervisor to a trial's process: one JSON document on its standard input.


class TrialRequest(BaseModel):
    """Everything that a trial's process needs to know.

    Nothing of it stands on a command line or in a variable, because a policy can read those of its harness.
    """

    # A message about a malformed request must not show credentials.
    model_config = ConfigDict(frozen=True, extra="forbid", hide_input_in_errors=True)

    spec: TrialSpec
    policy: PolicySetup
    out: Path
    """Recording to write."""
    weights: Path | None = None
    """Folder with the weights of the protocol's segmenter."""
    pace_s: float | None = None
    """Wall time [s] for each control period, as the policy sees it."""
    told_fd: int | None = None
    """File descriptor to which the worker tells when its policy runs and what it answers (``trials.told``)."""

    @model_validator(mode="after")
    def _one_policy(self) -> Self:
        check_setup(self.spec, self.policy)
        return self


def setup_of(spec: TrialSpec) -> PolicySetup:
    """Return the setup of a policy that needs nothing but what its trial says.

    Raises ConfigError for a malformed reference, ValueError for a trial that lets variables pass: their values are
    unknown.
    """
    setup = PolicySetup.of(spec.policy, arguments=spec.policy_arguments)
    check_setup(spec, setup)
    return setup


def check_setup(spec: TrialSpec, setup: PolicySetup) -> None:
    """Raises ValueError unless the setup is of the policy, arguments and variables that the trial records."""
    recorded = (spec.policy, spec.policy_arguments, spec.policy_environment)
    if recorded != (setup.ref.text, dict(setup.arguments), tuple(setup.environment)):
        raise ValueError(f"the trial records the policy {recorded[0]} {recorded[1:]}, but another one is set up")


# The interface of an engine. An engine carries out the trials of one run; the supervisor decides which trials, and
# when.

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
