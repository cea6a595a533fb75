from __future__ import annotations

from carecontact.reports.text import clipped_text, rounded
from tests.reports.synthetic_run import make_score


def test_one_trial_with_one_action_is_told_in_the_singular() -> None:
    assert "In 1 of 1 trial the benchmark" in clipped_text([make_score("T1", 0, clipped_actions=1)])
    assert "(1 action in all)" in clipped_text([make_score("T1", 0, clipped_actions=1)])
    several = clipped_text([make_score("T1", seed, clipped_actions=2) for seed in range(2)])
    assert "In 2 of 2 trials the benchmark" in several
    assert "(4 actions in all)" in several


def test_numbers_keep_about_three_digits_where_they_are_rounded_up() -> None:
    assert [rounded(value) for value in (9.994, 9.996, 99.94, 99.96, 0.0004, -9.996)] == [
        "9.99", "10.0", "99.9", "100", "0", "-10.0",
    ]  # fmt: skip
