"""From a policy's name to a conversation with it."""

from __future__ import annotations

import os
from collections.abc import Sequence

from carecontact.contract.policy_address import remote_address
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.process import PolicyProcess
from carecontact.hosting.remote import CREDENTIALS, RemotePolicy


def open_policy(
    policy: str, *, first_deadline_s: float, deadline_s: float, search_path: Sequence[str] = ()
) -> PolicyConversation:
    """Not started yet. ``policy``: a registered name, ``module:Class`` looked up in ``search_path`` first, or
    ``ws://HOST:PORT``, with credentials out of the environment variable CREDENTIALS.

    Raises UnknownNameError or ConfigError.
    """
    if remote_address(policy) is not None:
        return RemotePolicy(
            policy,
            first_deadline_s=first_deadline_s,
            deadline_s=deadline_s,
            credentials=os.environ.get(CREDENTIALS, ""),
        )
    return PolicyProcess(policy, first_deadline_s=first_deadline_s, deadline_s=deadline_s, search_path=search_path)
