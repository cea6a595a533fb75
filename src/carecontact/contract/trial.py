"""What one trial is, before it runs."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, model_serializer

from carecontact.contract.protocol import Protocol


class TrialSpec(BaseModel):
    """Everything that determines a trial besides the policy's answers. Frozen; part of the recording's header."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    protocol: Protocol
    task_id: str
    seed: int
    policy: str
    """Registry name, ``module:Class`` or ``ws://HOST:PORT``."""
    noise_salt: str = ""
    """Drawn by a run whose protocol names sensor noise and never shown to the policy: noise that protocol and seed
    alone decide would tell the seed to whoever tries the published ones against a single reading."""

    @model_serializer(mode="wrap")
    def _without_empty_salt(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A trial without a salt has the spelling, and so the hash, that it had before there were salts."""
        return {name: value for name, value in serialize(self).items() if name != "noise_salt" or value}

    @property
    def trial_id(self) -> str:
        """File stem, e.g. ``T1-s003``; unique inside a run, which has one policy."""
        return f"{self.task_id}-s{self.seed:03d}"
