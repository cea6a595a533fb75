"""The shipped person: contact = anchors = bed = robot joint torques, as the check itself measures them."""

from __future__ import annotations

from collections.abc import Callable

from carecontact.validation.result import CheckResult


def test_force_balances_by_independent_paths(short_form: Callable[[str], CheckResult]) -> None:
    result = short_form("force-balance")
    assert result.missed == []
    assert result.value("forearm: largest force") > 3.0
