from __future__ import annotations

import numpy as np
import pytest

from carecontact.audit.differences import differences

NAN = np.array([1.0, np.nan], np.float32)


@pytest.mark.parametrize("value", [{"a": [1, "b", None, True]}, NAN, {"x": NAN, "y": float("nan")}, np.zeros((0, 3))])
def test_equal_to_the_last_bit(value: object) -> None:
    assert differences(value, value, "m") == []


@pytest.mark.parametrize(
    ("expected", "got", "place", "told"),
    [
        ({"a": 1}, {"a": 1, "seed": 3}, "m.seed", "is present"),
        ({"a": 1, "b": 2}, {"a": 1}, "m.b", "is missing"),
        ({"a": [1, 2]}, {"a": [1, 3]}, "m.a[1]", "expected 2, got 3"),
        ([1], [1, 2], "m", "expected [1], got [1, 2]"),
        (1, True, "m", "expected 1, got True"),
        (1.0, 1.0 + 1e-15, "m", "expected 1.0"),
        (np.zeros(3), np.array([0.0, -0.0, 1e-300]), "m", "2 of 3 numbers differ, by up to 1e-300"),
        (np.zeros(3), np.zeros(3, np.float32), "m", "expected float64 (3,), got float32 (3,)"),
        (np.zeros((2, 2), bool), np.ones((2, 2), bool), "m", "4 of 4 numbers differ, by up to 1"),
        (NAN, np.array([1.0, 2.0], np.float32), "m", "1 of 2 numbers differ"),
    ],
)
def test_a_difference_is_named(expected: object, got: object, place: str, told: str) -> None:
    ((where, what),) = differences(expected, got, "m")
    assert where == place
    assert what.startswith(told)
