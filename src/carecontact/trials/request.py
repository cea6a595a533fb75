"""The request of the supervisor to a trial's process: one JSON document on its standard input."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from pydantic import BaseModel, ConfigDict, model_validator

from carecontact.contract.trial import TrialSpec
from carecontact.hosting.setup import PolicySetup


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
