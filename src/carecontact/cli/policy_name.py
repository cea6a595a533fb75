"""Is a policy there? Asked before a run, because afterwards each trial would fail for the same reason."""

from __future__ import annotations

import os
from pathlib import Path

from carecontact.errors import ConfigError, PolicyError
from carecontact.recording.reason import reason


def check_policy(policy: str, *, search_path: Path, deadline_s: float) -> None:
    """Raises UnknownNameError, or ConfigError saying in one line why ``module:Class`` does not start or why a server
    does not show its card.

    Both are started just as a trial starts them: the first in a process of its own and behind the wall.
    """
    from carecontact.contract.policy_address import remote_address
    from carecontact.hosting.opening import open_policy

    conversation = open_policy(
        policy, first_deadline_s=deadline_s, deadline_s=deadline_s, search_path=[str(search_path)]
    )
    if ":" not in policy:
        return
    try:
        with conversation:
            conversation.start()
    except PolicyError as error:
        remote = remote_address(policy) is not None
        where = "is no server of a policy" if remote else f"does not start (looked in {search_path} first)"
        raise ConfigError(f"--policy {policy} {where}: {reason(str(error))}") from None


def public_name(policy: str) -> str:
    """The name as it may stand in a recording. The credentials of an address go on to the trials' processes by the
    environment. Raises ConfigError for a malformed address."""
    from carecontact.contract.policy_address import remote_address
    from carecontact.hosting.remote import CREDENTIALS

    address = remote_address(policy)
    if address is None:
        return policy
    if address.credentials:
        os.environ[CREDENTIALS] = address.credentials
    return str(address)
