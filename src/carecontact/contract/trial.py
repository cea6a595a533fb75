"""What one trial is, before it runs."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from carecontact.contract.protocol import Protocol


class TrialSpec(BaseModel):
    """Everything that determines a trial besides the policy's answers. Frozen; part of the recording's header."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    protocol: Protocol
    task_id: str
    seed: int
    policy: str
    """Registry name, ``module:Class`` or ``ws://HOST:PORT``."""

    @property
    def trial_id(self) -> str:
        """File stem, e.g. ``T1-s003``; unique inside a run, which has one policy."""
        return f"{self.task_id}-s{self.seed:03d}"
