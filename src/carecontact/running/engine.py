"""What an engine that runs trials is given and returns, what a worker is asked for, and the pipe for its reports."""

from __future__ import annotations

import json
import math
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, model_validator

from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.serving.conversation import PolicySetup

if TYPE_CHECKING:
    from carecontact.runs.identity import Identity


class StatusPipe:
    """The supervisor's end of a worker's status pipe: JSON, one object a line. It works even if the disk is full."""

    def __init__(self, pipe: int) -> None:
        """``pipe``: file descriptor to read from, which this object then owns."""
        os.set_blocking(pipe, False)
        self._pipe, self._rest = pipe, b""
        self.answers = b""
        """Digests of the policy's answers, one after another."""
        self.said: dict[str, Any] = {}
        """The last value of everything else that ``worker.Reports`` names."""
        self.waited_s = -math.inf
        """When the worker last said that it waits for its policy."""

    @property
    def policy_runs(self) -> bool:
        return self.said.get("policy_runs", False)

    def read(self) -> None:
        """Read the messages that have arrived. Call it repeatedly: the other end waits while the pipe is full."""
        with suppress(BlockingIOError):
            while piece := os.read(self._pipe, 1 << 16):
                self._rest += piece
        *lines, self._rest = self._rest.split(b"\n")
        for said in map(json.loads, lines):
            self.answers += bytes.fromhex(said.pop("answer", ""))
            if "waiting" in said:
                self.waited_s = time.monotonic()
            self.said |= said

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
    pace_s: float | None = None
    """Wall time [s] for each control period, as the policy sees it."""
    status_fd: int | None = None

    @model_validator(mode="after")
    def _one_policy(self) -> Self:
        check_setup(self.spec, self.policy)
        return self


def setup_of(spec: TrialSpec) -> PolicySetup:
    """Return the setup of a policy that needs nothing but what its trial says."""
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
    out: Path
    """Folder for the recordings and logs."""
    work: Path
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
