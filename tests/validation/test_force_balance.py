"""The shipped person: contact = anchors = bed = robot joint torques, as the check itself measures them."""

from __future__ import annotations

from carecontact.validation import force_balance
from carecontact.validation.subject import Subject


def test_force_balances_by_independent_paths(subject: Subject) -> None:
    result = force_balance.run(subject, quick=True)
    assert result.missed == []
    assert result.value("forearm: largest force") > 3.0
