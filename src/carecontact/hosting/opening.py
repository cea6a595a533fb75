"""Makes the conversation with a policy from the policy's setup."""

from __future__ import annotations

from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.process import PolicyProcess
from carecontact.hosting.remote import RemotePolicy
from carecontact.hosting.setup import PolicySetup


def open_policy(setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> PolicyConversation:
    """Return a conversation that has not started yet. Raises UnknownNameError for an unknown policy."""
    conversation = RemotePolicy if setup.ref.kind == "remote" else PolicyProcess
    return conversation(setup, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
