from __future__ import annotations

import pytest

from carecontact.reports.compare.rankings import rank
from carecontact.scoring import TrialScore
from tests.reports.synthetic_run import FAILED, make_score


def method(name: str, peaks_n: list[float], *, failures: int = 0, floor: int = 3) -> list[TrialScore]:
    """Successes of the given peaks on a segment that bears 100 N, then failures; ``floor``: level at the 1 N floor."""
    sweep = {"floor_n": {"0.5": 3, "1": floor}}
    rows = [
        make_score(
            "T1", seed, policy=name, peak_force_n={"right_forearm": peak}, gate_sweep=sweep,
            safety_gated=peak <= 35, over_limit={"right_forearm": peak / 35} if peak > 35 else {},
        )
        for seed, peak in enumerate(peaks_n)
    ]  # fmt: skip
    failed = {"gate_sweep": {"floor_n": {"0.5": 0, "1": 0}}} | FAILED
    return rows + [make_score("T1", len(rows) + k, policy=name, **failed) for k in range(failures)]


GENTLE = method("gentle", [10.0, 10.0, 10.0], failures=3, floor=0)
MIDDLE = method("middle", [30.0, 30.0], failures=4)
HARD = method("hard", [50.0] * 5 + [30.0], failures=0)


def test_order_turns_where_harder_presses_are_allowed() -> None:
    """Gated at 0.35: 3, 2 and 1 of 6. From 0.50 on hard has all 6."""
    found = rank({"gentle": GENTLE, "middle": MIDDLE, "hard": HARD})
    assert found.order == (("gentle",), ("middle",), ("hard",))
    assert found.shares["gamma 0.35"] == {"gentle": 0.5, "middle": pytest.approx(1 / 3), "hard": pytest.approx(1 / 6)}
    assert found.sweep.tau["gamma 0.35"].tau == pytest.approx(1.0)
    assert found.sweep.tau["gamma 1"].tau == pytest.approx(-1 / 3)
    assert found.sweep.tau["success"].tau == pytest.approx(-1 / 3)
    assert found.least_by_sweep()["gamma"] == (pytest.approx(-1 / 3), "gamma 0.5")
    assert found.least_by_sweep()["floor_n"][1] == "floor_n 1"


def test_equal_methods_share_a_place_and_order_nothing() -> None:
    found = rank({"one": MIDDLE, "two": MIDDLE})
    assert found.order == (("one", "two"),)
    assert found.sweep.least is None
    assert found.least_by_sweep()["gamma"] == (None, "")
