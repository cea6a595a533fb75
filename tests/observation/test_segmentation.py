from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carecontact.contract.observation import MASK_NAMES
from carecontact.observation import segmentation
from carecontact.observation.segmentation import robot_mask, segment

SHAPE = (6, 8)
F32 = np.float32


def points_of(depth: np.ndarray) -> np.ndarray:
    """Pixels 10 mm apart, seen from 2 m above a bed at height 0."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    return np.stack([0.01 * u, 0.01 * v, 2.0 - depth.astype(float)], -1)


def segmented(person: np.ndarray, depth: np.ndarray, robot: np.ndarray, cell: np.ndarray) -> dict[str, np.ndarray]:
    return segment(
        person=person,
        depth=depth,
        robot_depth=robot,
        cell_depth=cell,
        points=points_of(depth),
    )


def test_known_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segmentation, "bed_plane", lambda points, *, free, person: np.zeros(3))
    # Columns: person, sheet and pillow with a person's label, robot over the person, bed, floor, nothing, person
    # before a place where the empty cell has no depth.
    person = np.ones((1, 8), F32)
    depth = np.array([[1.8, 1.995, 1.95, 1.5, 2.0, 2.6, np.nan, 1.8]], F32)
    robot = np.array([[np.nan, np.nan, np.nan, 1.51, np.nan, 2.5, np.nan, np.nan]], F32)
    cell = np.array([[2.0, 2.0, 1.95, 2.0, 2.0, 2.6, 2.0, np.nan]], F32)
    masks = segmented(person, depth, robot, cell)
    assert set(masks) == set(MASK_NAMES)
    names = [next(name for name in MASK_NAMES if masks[name][0, k]) for k in range(8)]
    assert names == ["human", "bed", "background", "robot", "bed", "background", "background", "human"]


def test_the_bed_is_what_the_picture_shows() -> None:
    person = np.zeros((60, 90), F32)
    person[20:40, 30:60] = 0.9
    for height in (0.0, 0.11):
        depth = np.full(person.shape, 2.0 - height, F32)
        cell = depth.copy()
        depth[20:40, 30:60] -= 0.2
        depth[:, 80:] = 2.55  # the floor
        masks = segmented(person, depth, np.full(person.shape, np.nan, F32), cell)
        assert masks["human"].sum() == 20 * 30
        assert masks["bed"].sum() == 60 * 80 - 20 * 30
        assert masks["background"][:, 80:].all()


def test_what_the_pose_mask_misses_is_human_only_near_it() -> None:
    person = np.zeros((60, 90), F32)
    person[20:40, 20:40] = 0.9
    cell = np.full(person.shape, 2.0, F32)
    depth = cell.copy()
    depth[28:32, 20:44] = 1.8  # an arm, its hand beyond the pose mask
    depth[28:32, 70:80] = 1.8  # something else on the bed
    human = segmented(person, depth, np.full(person.shape, np.nan, F32), cell)["human"]
    assert human.sum() == 4 * 24
    assert not human[:, 70:].any()


def test_nobody_found_is_an_empty_mask() -> None:
    cell = np.full(SHAPE, 2.0, F32)
    masks = segmented(np.zeros(SHAPE, F32), cell - 0.2, np.full(SHAPE, np.nan, F32), cell)
    assert not masks["human"].any()


def test_robot_tolerance() -> None:
    seen = np.array([[1.0, 1.0, 1.0, np.nan]], F32)
    predicted = np.array([[1.019, 1.021, np.nan, 1.0]], F32)
    assert robot_mask(seen, predicted).tolist() == [[True, False, False, False]]


DEPTHS = arrays(F32, SHAPE, elements=st.one_of(st.just(float("nan")), st.floats(1.5, 2.5, width=32)))


@given(person=arrays(F32, SHAPE, elements=st.floats(0, 1, width=32)), depth=DEPTHS, robot=DEPTHS, cell=DEPTHS)
def test_masks_are_disjoint_and_cover_the_image(
    person: np.ndarray, depth: np.ndarray, robot: np.ndarray, cell: np.ndarray
) -> None:
    masks = segmented(person, depth, robot, cell)
    assert (sum(mask.astype(int) for mask in masks.values()) == 1).all()
    assert not (masks["human"] & np.isnan(depth)).any()
