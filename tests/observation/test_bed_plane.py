from __future__ import annotations

import numpy as np
import pytest

from carecontact.observation.bed_plane import bed_plane

F64 = np.ndarray
GRID = np.stack(np.meshgrid(np.arange(-1.0, 1.0, 0.005), np.arange(-0.8, 0.8, 0.005), indexing="xy"), -1)
X, Y = GRID[..., 0], GRID[..., 1]
MATTRESS, PERSON = np.abs(Y) < 0.45, (np.abs(Y) < 0.2) & (np.abs(X) < 0.8)
BOARD = (np.abs(X - 0.2) < 0.25) & (Y > 0.3) & (Y < 0.79)


def scene(height_m: float, *, tilt: tuple[float, float] = (0.0, 0.0), noise_m: float = 0.0) -> F64:
    """(H, W, 3) [m] floor, mattress, an arm board 22 mm above it and a person on it, 5 mm apart."""
    top = height_m + tilt[0] * X + tilt[1] * Y
    z = np.where(MATTRESS, top, height_m - 0.6)
    z = np.where(BOARD, top + 0.022, z)
    z = np.where(PERSON, top + 0.2 * np.cos(np.pi * Y / 0.4), z)
    z = z + noise_m * np.random.default_rng(3).standard_normal(z.shape)
    return np.stack([X, Y, z], -1)


@pytest.mark.parametrize("height_m", [-0.1, 0.07, 0.2])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.004, -0.006)])
@pytest.mark.parametrize("noise_m", [0.0, 0.006])
def test_the_plane_is_the_mattress_under_person_and_board(
    height_m: float, tilt: tuple[float, float], noise_m: float
) -> None:
    plane = bed_plane(scene(height_m, tilt=tilt, noise_m=noise_m), free=~PERSON, person=PERSON)
    assert plane is not None
    away = X * plane[0] + Y * plane[1] + plane[2] - (height_m + tilt[0] * X + tilt[1] * Y)
    assert np.abs(away[MATTRESS]).max() < (0.002 if noise_m else 1e-4)


def test_what_lies_under_the_bed_in_the_same_place_does_not_count() -> None:
    """An oblique camera sees the floor under the near edge of the mattress: two surfaces over one another."""
    floor = scene(0.07)
    floor[..., 2] = -0.55
    points = np.concatenate([scene(0.07), floor])
    person = np.concatenate([PERSON, np.zeros_like(PERSON)])
    plane = bed_plane(points, free=~person, person=person)
    np.testing.assert_allclose(plane, [0, 0, 0.07], atol=1e-9)


def test_less_than_a_twentieth_of_a_mattress_is_no_bed() -> None:
    for width, found in ((0.06, False), (0.15, True)):
        free = MATTRESS & (np.abs(Y - 0.35) < width / 2) & (np.abs(X + 0.5) < 0.5)
        assert (bed_plane(scene(0.07), free=free, person=PERSON) is not None) is found


def test_where_nobody_is_seen_there_is_no_bed() -> None:
    assert bed_plane(scene(0.07), free=~PERSON, person=np.zeros_like(PERSON)) is None


def test_a_small_picture_shows_the_bed_too() -> None:
    plane = bed_plane(scene(0.07)[::4, ::4], free=~PERSON[::4, ::4], person=PERSON[::4, ::4])
    np.testing.assert_allclose(plane, [0, 0, 0.07], atol=1e-9)


def test_neither_floor_nor_wall_is_a_bed() -> None:
    """The bed is hidden: only the person, the floor below and a steep wall remain."""
    points = scene(0.07)
    wall = ~PERSON & (Y > 0.4)
    points[wall, 2] = 3 * X[wall]
    hidden = MATTRESS | BOARD
    assert bed_plane(points, free=~PERSON & (~hidden | wall), person=PERSON) is None


def test_pixels_without_depth_change_nothing() -> None:
    points, holes = scene(0.07), np.random.default_rng(0).random(X.shape) < 0.3
    points[holes, 2] = np.nan
    plane = bed_plane(points, free=~PERSON, person=PERSON)
    np.testing.assert_allclose(plane, [0, 0, 0.07], atol=1e-9)
    points[..., 2] = np.nan
    assert bed_plane(points, free=~PERSON, person=PERSON) is None
