"""What an engine that runs trials has to do, what a worker is asked for, and the pipe on which it reports its
status."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, Self

from pydantic import BaseModel, ConfigDict, model_validator

from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.serving.conversation import PolicySetup

if TYPE_CHECKING:
    from carecontact.runs.identity import Identity

POLICY_RUNS, POLICY_GONE, ANSWERED = b"+", b"-", b"="
"""Status of a worker: the process of a local policy is about to start; it is gone; it answered, and DIGEST_BYTES
follow."""
DIGEST_BYTES = 32


class StatusPipe:
    """The supervisor's end of a worker's status pipe, which works even if the disk is full."""

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


class TrialRequest(BaseModel):
    """Everything that a worker needs to know, as one JSON document on its standard input.

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
    status_fd: int | None = None
    """File descriptor of the worker's end of the status pipe."""

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


EngineName = Literal["local", "ray"]
"""``local``: this machine (``running.workers``); ``ray``: the nodes of a Ray cluster (``running.ray_engine``)."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """The settings that all trials of one run share."""

    out: Path
    """Folder for the recordings and logs."""
    work: Path
    """Folder for files that are not finished."""
    policy: PolicySetup
    identity: Identity
    weights: Path | None = None
    pace_s: float | None = None
    trial_limit_s: float
    command: tuple[str, ...] | None = None
    """Command that starts a trial's process on any machine; None: each machine's own."""
    killed: frozenset[str] = frozenset()
    """Trials in ``out`` that an earlier command lost to a signal."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """An attempt at a trial that has ended."""

    spec: TrialSpec
    kind: Literal["recorded", "lost", "unreached", "unstored", "lacked"]
    """``recorded``: the recording is in the run's folder; ``lost``: the trial has to run once more; ``unreached``: no
    trial can begin, because the policy's server could not be reached or a package is missing; ``unstored``: there was
    no space for what the trial stores; ``lacked``: the trial got no process, thread or memory, and may get it later."""
    why: str = ""
    """What happened, of every kind but ``recorded``."""
    recording: Recording | None = None
    warnings: tuple[str, ...] | None = None
    """Warnings about the policy's first answer; None if it gave no answer."""


class Engine(Protocol):
    """The trials of one run that run now. One thread calls it; no call waits for a trial.

    The supervisor decides which trials an engine carries out, and when.
    """

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
