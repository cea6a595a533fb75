"""The upper arm's region begins where a chest, as the camera sees it, leaves room for the hand."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.regions import REGIONS, LimbSight
from carecontact.sight.region import HALF_SCRUB_M, MIN_REGION_M, free_from

SIGHT = REGIONS["upper_arm"].sight
assert isinstance(SIGHT, LimbSight)
START, END = np.array([0.0, 0.0, 0.08]), np.array([0.27, 0.0, 0.08])
PITCH_M = 0.004


def surface(low: tuple[float, float], high: tuple[float, float], height_m: float) -> np.ndarray:
    x, y = (np.arange(a, b, PITCH_M) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    return np.c_[grid, np.full(len(grid), height_m)]


def person(chest_until_m: float, chest_height_m: float) -> np.ndarray:
    """An arm 80 mm high, and beside it a chest up to a distance from the shoulder."""
    arm = surface((-0.05, -0.04), (0.33, 0.04), 0.08)
    return np.concatenate([arm, surface((-0.15, 0.05), (chest_until_m, 0.25), chest_height_m)])


def test_a_flat_or_distant_chest_changes_nothing() -> None:
    assert free_from(SIGHT, person(0.20, 0.10), START, END) == SIGHT.free_from
    assert free_from(SIGHT, person(-0.10, 0.20), START, END) == SIGHT.free_from


def test_a_high_chest_moves_the_region_until_half_a_scrub_is_free() -> None:
    """The hand's corners, 120 mm from the tool, meet a chest 50 mm beside the arm's line 109 mm farther along it."""
    share = free_from(SIGHT, person(0.07, 0.20), START, END)
    crowded_m = 0.07 + np.sqrt(0.12**2 - 0.05**2)
    length = END[0]
    middle = (1 + share) / 2 * length
    # A chest that only just reaches under the hand has too few points to count.
    assert crowded_m - 0.01 < middle < crowded_m + HALF_SCRUB_M + 0.005
    assert share > SIGHT.free_from


def test_some_of_the_arm_always_stays() -> None:
    share = free_from(SIGHT, person(0.33, 0.20), START, END)
    assert (1 - share) * END[0] == pytest.approx(MIN_REGION_M)


def test_a_forearm_has_no_trunk_beside_it() -> None:
    sight = REGIONS["forearm"].sight
    assert isinstance(sight, LimbSight)
    assert free_from(sight, person(0.33, 0.20), START, END) == 0.0
