from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.validation.result import CheckResult, Measure


def result(*measures: Measure, error: str | None = None) -> CheckResult:
    return CheckResult(check="c", title="C", measures=measures, error=error)


@pytest.mark.parametrize(
    ("value", "side", "met"),
    [(1.0, "at most", True), (1.1, "at most", False), (1.0, "at least", True), (0.9, "at least", False),
     (1.0, "below", False), (0.9, "below", True), (float("nan"), "at most", False), (float("-inf"), "at most", False),
     (float("inf"), "at least", False)],
)  # fmt: skip
def test_a_line_is_met_on_its_own_side(value: float, side, met: bool) -> None:
    assert Measure(name="m", value=value, limit=1.0, side=side).met is met


def test_without_a_limit_nothing_is_met_or_missed() -> None:
    assert Measure(name="m", value=float("nan")).met is None


def test_only_deciding_lines_decide() -> None:
    good, bad = Measure(name="a", value=0.0, limit=1.0), Measure(name="b", value=2.0, limit=1.0)
    shown = Measure(name="b", value=2.0, limit=1.0, decides=False)
    assert result(good, shown).passed
    assert result(good, shown).missed == []
    assert not result(good, bad).passed
    assert result(good, bad).missed == [bad]


def test_a_check_that_decides_nothing_has_not_passed() -> None:
    assert not result().passed
    assert not result(Measure(name="a", value=0.0)).passed
    assert not result(Measure(name="a", value=0.0, limit=1.0), error="it did not settle").passed


def test_value_names_what_there_is() -> None:
    assert result(Measure(name="a", value=3.0)).value("a") == 3.0
    with pytest.raises(KeyError, match="there are: a"):
        result(Measure(name="a", value=3.0)).value("b")


@given(st.floats(allow_nan=True, allow_infinity=True), st.floats(allow_nan=False, allow_infinity=False))
def test_json_is_strict_and_close(value: float, limit: float) -> None:
    got = json.loads(json.dumps(Measure(name="m", value=value, limit=limit).as_json(), allow_nan=False))
    if got["value"] is None:
        assert value != value or abs(value) == float("inf")
    else:
        assert got["value"] == pytest.approx(value, rel=1e-5)
