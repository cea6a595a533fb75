"""The specification of one trial, as it is known before the trial runs."""

from __future__ import annotations

import hashlib
from typing import Self

from pydantic import BaseModel, ConfigDict, Field

from carecontact.contract.protocol import Protocol


def commitment(salt: str) -> str:
    """Return the sha256 of a salt's characters, in base 16: what may be published before the salt."""
    return hashlib.sha256(salt.encode()).hexdigest()


class TrialSpec(BaseModel):
    """Everything that determines a trial besides the policy's answers. Frozen; part of the recording's header."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    protocol: Protocol
    task_id: str
    seed: int
    policy: str
    """Text of its ``PolicyRef``: a registered name, ``module:Class`` or an address."""
    policy_arguments: dict[str, str] = {}
    """Arguments of --policy-arg: name -> text. A language backend that --language named stands in the policy's card."""
    policy_environment: tuple[str, ...] = ()
    """Names of the variables that --policy-env let pass."""
    noise_salt: str = ""
    """Drawn once per run whose protocol has sensor noise, and never shown to the policy: if protocol and seed alone
    determined the noise, a policy could find the seed by comparing a single reading with the noise of every published
    seed."""
    salt: str = Field(default="", repr=False)
    """Secret of a run whose persons nobody may know beforehand: every draw of the trial depends on it. A recording
    never holds it, only its hash (``sealed``); empty for a run on published seeds."""
    salt_sha256: str = ""
    """Hash of the salt of a recorded trial, in base 16."""

    @property
    def commitment(self) -> str:
        """The sha256 of the salt in base 16, which may be published before the run; empty where there is no salt."""
        return commitment(self.salt) if self.salt else self.salt_sha256

    @property
    def sealed(self) -> Self:
        """The trial with the hash of its salt in place of the salt, as a recording names it."""
        return self.model_copy(update={"salt": "", "salt_sha256": self.commitment}) if self.salt else self

    @property
    def trial_id(self) -> str:
        """File stem, e.g. ``T1-s003``; unique inside a run, which has one policy."""
        return f"{self.task_id}-s{self.seed:03d}"
