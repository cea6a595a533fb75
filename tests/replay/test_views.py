"""The side from which a video shows a contact."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from carecontact.episode.randomization import set_place
from carecontact.recording import Recording
from carecontact.replay.replay import Replay
from carecontact.replay.stage import FilmSkin, film_scene, turned
from carecontact.replay.views import clear_view, eye_place


@pytest.fixture(scope="module")
def world(pressed: Recording) -> tuple[mujoco.MjModel, FilmSkin]:
    scene = film_scene(Replay(pressed).scene, "forearm")
    set_place(scene, scene.place)
    return scene.model, FilmSkin(scene)


@contextmanager
def board_at(model: mujoco.MjModel, place: np.ndarray, half_sizes_m: list[float]) -> Iterator[None]:
    """Put the world's wall, as a board of this size, at a place (3,) [m]."""
    board = model.geom("wall")
    kept = board.pos.copy(), board.size.copy()
    board.pos, board.size = place.tolist(), half_sizes_m
    model.geom_rbound[board.id] = float(np.linalg.norm(half_sizes_m))
    try:
        yield
    finally:
        board.pos, board.size = kept


def test_the_camera_goes_to_another_side_when_something_stands_before_it(
    pressed: Recording, world: tuple[mujoco.MjModel, FilmSkin]
) -> None:
    model, skin = world
    free = clear_view(pressed, model, skin)
    with board_at(model, 0.7 * eye_place(free) + 0.3 * free.look_at, [0.12, 0.12, 0.12]):
        other = clear_view(pressed, model, skin)
    assert np.linalg.norm(eye_place(other) - eye_place(free)) > 0.2
    way = eye_place(other) - other.look_at
    offset = 0.7 * (eye_place(free) - free.look_at)
    beside = np.linalg.norm(np.cross(way, offset)) / np.linalg.norm(way)
    assert beside > 0.12 or way @ offset < 0, "the line of sight passes the board"


def pushed_from_the_side(
    pressed: Recording, model: mujoco.MjModel, skin: FilmSkin
) -> tuple[Recording, np.ndarray, np.ndarray]:
    """The press as if its contact were on the side of the forearm that its own view does not show; the contact's place
    [m] and the skin's normal there."""
    segment = pressed.header.segments.index("right_forearm")
    column = pressed.header.regions.index("forearm")
    middle = pressed["scorer/region_pose_in_world"][0, column][:3]
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, pressed["state/integration"][-1], mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_kinematics(model, data)
    vertices, normals = skin.placed(data)
    near = (np.linalg.norm(vertices - middle, axis=1) < 0.08) & (np.abs(normals[:, 2]) < 0.1)
    far = np.flatnonzero(near)[(normals[near] @ (eye_place(clear_view(pressed, model, skin)) - middle)).argmin()]
    place, normal = vertices[far], normals[far]
    arrays = dict(pressed.arrays)
    centres = arrays["scorer/centroid_in_world"].copy()
    centres[:, segment] = place
    return replace(pressed, arrays={**arrays, "scorer/centroid_in_world": centres}), place, normal


def test_a_push_on_the_far_side_is_not_shown_from_the_near_one(
    pressed: Recording, world: tuple[mujoco.MjModel, FilmSkin]
) -> None:
    model, skin = world
    moved, place, normal = pushed_from_the_side(pressed, model, skin)
    before, after = (eye_place(clear_view(found, model, skin)) - place for found in (pressed, moved))
    assert before @ normal < 0 < after @ normal, "the side of a press from above would show its back"


def test_a_push_under_a_hand_is_shown_from_a_flat_view(
    pressed: Recording, world: tuple[mujoco.MjModel, FilmSkin]
) -> None:
    """The hand that pushes from the side is above the contact, as far as a view from above could look past it."""
    model, skin = world
    moved, place, normal = pushed_from_the_side(pressed, model, skin)
    with board_at(model, place + 0.1 * normal + [0.0, 0.0, 0.06], [0.25, 0.25, 0.01]):
        shown = clear_view(moved, model, skin)
    way = eye_place(shown) - place
    assert way @ normal > 0
    assert np.degrees(np.arcsin(way[2] / np.linalg.norm(way))) < 20


def test_a_direction_turns_about_the_vertical() -> None:
    assert turned(np.array([1.0, 0.0, -0.5]), 90.0) == pytest.approx([0.0, 1.0, -0.5])
