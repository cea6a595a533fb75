from __future__ import annotations

from carecontact.reports.text import clipped_text
from tests.reports.synthetic_run import make_score


def test_one_trial_with_one_action_is_told_in_the_singular() -> None:
    assert "In 1 of 1 trial the benchmark" in clipped_text([make_score("T1", 0, clipped_actions=1)])
    assert "(1 action in all)" in clipped_text([make_score("T1", 0, clipped_actions=1)])
    several = clipped_text([make_score("T1", seed, clipped_actions=2) for seed in range(2)])
    assert "In 2 of 2 trials the benchmark" in several
    assert "(4 actions in all)" in several
