"""What a policy is for, as its row says."""

from __future__ import annotations

from carecontact.policies.registry import POLICIES
from carecontact.reports.sweep.persons import Role

BLIND = ("zero-action", "hover", "random", "replay")


def role_of(policy: str) -> Role:
    """A policy that no row describes is a method."""
    row = POLICIES[policy] if policy in POLICIES else None
    return getattr(row, "role", "blind" if policy in BLIND else "method")
