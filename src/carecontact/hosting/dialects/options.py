"""Checks the options in the address of a dialect's server before anything is connected."""

from __future__ import annotations

from carecontact.contract.policy_ref import PolicyRef
from carecontact.errors import ConfigError, did_you_mean
from carecontact.hosting.dialects.profiles import SPACES, named_profile


def check_options(ref: PolicyRef) -> None:
    """Check the options. Raises ConfigError for an unknown profile or action space; the message lists the known
    ones.
    """
    options = dict(ref.options)
    if "profile" in options:
        try:
            named_profile(options)
        except ConfigError as error:
            raise ConfigError(f"policy {ref}: {error}") from None
    spaces = tuple(SPACES.values())
    if "space" in options and options["space"] not in spaces:
        meant = did_you_mean(options["space"], spaces)
        raise ConfigError(
            f"policy {ref}: no action space {options['space']!r} in this dialect{meant}; valid: {', '.join(spaces)}"
        )
