"""Shadows of a board over a floor, and outlines, where both are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carecontact.replay.shadow import BIAS_M, MAP_PX, Eye, Lamp, edges, shade, widened

RADIUS_M, BOARD_M, HIGH_M = 0.4, 0.1, 0.2
"""The board is square, of this half side, and so far above the floor."""
LAMP = Lamp.of(np.zeros(3), np.array([0.0, 1e-6, -1.0]), RADIUS_M)


def seen_by_lamp() -> np.ndarray:
    at = (np.arange(MAP_PX) + 0.5) / MAP_PX * 2 * RADIUS_M - RADIUS_M
    board = (np.abs(at) < BOARD_M)[:, None] & (np.abs(at) < BOARD_M)
    return np.where(board, np.float32(-HIGH_M), np.float32(0))


def floor(x: np.ndarray) -> np.ndarray:
    return np.stack([x, np.zeros_like(x), np.zeros_like(x)], -1).astype(np.float32)


def test_the_shadow_of_a_board_is_soft_at_its_edge_only() -> None:
    x = np.linspace(0, 0.39, 400)
    lit = LAMP.lit(floor(x), np.ones_like(x, np.float32), seen_by_lamp())
    soft = 3.0 * 2 * RADIUS_M / MAP_PX
    assert (lit[x < BOARD_M - soft] == 0).all()
    assert (lit[x > BOARD_M + soft] == 1).all()
    assert (np.diff(lit) >= 0).all()
    assert 0.3 < np.interp(BOARD_M, x, lit) < 0.7
    assert len(np.unique(lit)) > 3, "not a hard edge"


def test_the_board_itself_and_what_the_lamp_does_not_see_are_lit() -> None:
    on_board = np.array([[0.0, 0.0, -HIGH_M + 0.9 * BIAS_M]], np.float32)
    beyond = floor(np.array([1.1 * RADIUS_M]))
    assert (LAMP.lit(np.concatenate([on_board, beyond]), np.ones(2, np.float32), seen_by_lamp()) == 1).all()


@given(slope=st.floats(0, 4), radius_m=st.sampled_from([0.3, 2.2]))
def test_a_steep_plane_casts_no_shadow_on_itself(slope: float, radius_m: float) -> None:
    lamp = replace(LAMP, radius_m=radius_m)
    at = ((np.arange(MAP_PX) + 0.5) / MAP_PX * 2 - 1) * radius_m
    seen = np.tile((slope * at).astype(np.float32), (MAP_PX, 1))
    x = np.linspace(-0.9, 0.9, 300) * radius_m
    places = np.stack([x, np.zeros_like(x), slope * x], -1).astype(np.float32)
    facing = np.full(len(x), 1 / np.hypot(1, slope), np.float32)
    assert (lamp.lit(places, facing, seen) == 1).all()


def test_a_shadow_takes_the_share_of_the_lamp_and_stops_at_an_outline() -> None:
    eye = Eye(position=np.array([0.0, 0.0, 1.0]), axes=np.diag([1.0, -1.0, -1.0]), focal_px=100.0, size=(80, 60))
    metres = np.ones((60, 80), np.float32)
    metres[:, :5] = 0.5  # A wall before the floor, outside the shadow.
    picture = np.full((60, 80, 3), 200, np.uint8)
    facing: list[np.ndarray] = []

    def key_share(normal: np.ndarray) -> np.ndarray:
        facing.append(normal[10:20, 10:20])
        return np.full(normal.shape[:2], 0.6, np.float32)

    shade(picture, metres, widened(edges(np.float32(1) / metres)), eye, LAMP, seen_by_lamp(), key_share)
    np.testing.assert_allclose(facing[0].reshape(-1, 3), [[0, 0, 1]] * 100, atol=1e-5)
    assert (picture[30, 33:46] == 79).all(), "0.4 of 200, rounded down, under the board"
    assert (picture[30, :20] == 200).all()
    assert (picture[:12] == 200).all()


def test_a_plane_has_no_outline_and_a_step_has_one() -> None:
    depth = np.tile(np.linspace(0.2, 0.4, 40, dtype=np.float32), (30, 1))
    assert not edges(depth).any()
    depth[:, 20:] += 0.2
    assert set(np.flatnonzero(edges(depth).any(0))) == {19, 20}
