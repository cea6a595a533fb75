"""The shipped person: contact = anchors = bed = robot joint torques, as the check itself measures them; a force that is
read the wrong way round is none of the others."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from carecontact.protocols import load_protocol
from carecontact.validation import force_balance
from carecontact.validation.result import CheckResult

from .defects import PushedAtItsOrigin, PushedTheWrongWay, ReadsWrong


def test_force_balances_by_independent_paths(short_form: Callable[[str], CheckResult]) -> None:
    result = short_form("force-balance")
    assert result.missed == []
    assert result.value("forearm: largest force") > 3.0


def test_a_force_on_the_bone_with_the_wrong_sign_is_found() -> None:
    missed = {
        m.name: m.value
        for m in force_balance.run(ReadsWrong(load_protocol(), rings=PushedTheWrongWay), quick=True).missed
    }
    assert missed == {
        "forearm: contact against anchors": pytest.approx(200, abs=2),
        "forearm: contact against robot joint torques": pytest.approx(200, abs=2),
        "forearm: bed reaction against weight and press": pytest.approx(200, abs=2),
    }


def test_a_bone_that_is_pushed_without_a_moment_is_found() -> None:
    missed = [m for m in force_balance.run(ReadsWrong(load_protocol(), readings=PushedAtItsOrigin), quick=True).missed]
    assert [m.name for m in missed] == ["forearm: moment on the bone against the anchors' moment, over the force"]
    assert missed[0].value > 30
