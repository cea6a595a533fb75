from __future__ import annotations

import numpy as np
import pytest

from carecontact.reports.trial.clip import inside


def test_a_line_is_cut_where_it_leaves_and_begins_anew_where_it_comes_back() -> None:
    line = np.array([[10, 10], [30, 10], [30, 90], [70, 90], [70, 10], [120, 10]], float)
    parts = inside(line, 100, 50)
    assert parts == [
        [(10, 10), (30, 10), (30, 50)], [(70, 50), (70, 10), (100, 10)]
    ]  # fmt: skip


def test_a_line_that_crosses_between_two_points_outside_is_seen() -> None:
    assert inside(np.array([[-50, 25], [150, 25]], float), 100, 50) == [[(0, 25), (100, 25)]]
    assert inside(np.array([[-50, 60], [150, 60], [150, 25]], float), 100, 50) == []
    assert inside(np.array([[1.0, 1.0]]), 100, 50) == []


def test_points_that_look_like_one_are_one_but_the_ends_stay() -> None:
    x = np.linspace(0, 10, 1001)
    (part,) = inside(np.stack([x, np.full_like(x, 5)], axis=1), 100, 50)
    assert part[0] == (0, 5)
    assert part[-1] == pytest.approx((10, 5))
    assert len(part) < 20
