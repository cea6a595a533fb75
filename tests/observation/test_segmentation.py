from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carecontact.contract.observation import MASK_NAMES
from carecontact.observation.segmentation import robot_mask, segment

SHAPE = (6, 8)
F32 = np.float32


def test_known_pixels() -> None:
    # Columns: person, sheet with a person's label, robot over the person, bed, floor, nothing.
    person = np.array([[0.9, 0.9, 0.9, 0.1, 0.1, 0.1]], F32)
    depth = np.array([[1.8, 1.995, 1.5, 2.0, 2.6, np.nan]], F32)
    robot = np.array([[np.nan, np.nan, 1.51, np.nan, 2.5, np.nan]], F32)
    height = 2.0 - depth.astype(float)
    masks = segment(person=person, depth=depth, robot_depth=robot, height_in_base=height, bed_height_in_base_m=0.0)
    assert set(masks) == set(MASK_NAMES)
    names = [next(name for name in MASK_NAMES if masks[name][0, k]) for k in range(6)]
    assert names == ["human", "bed", "robot", "bed", "background", "background"]


def test_robot_tolerance() -> None:
    seen = np.array([[1.0, 1.0, 1.0, np.nan]], F32)
    predicted = np.array([[1.019, 1.021, np.nan, 1.0]], F32)
    assert robot_mask(seen, predicted).tolist() == [[True, False, False, False]]


@given(
    person=arrays(F32, SHAPE, elements=st.floats(0, 1, width=32)),
    depth=arrays(F32, SHAPE, elements=st.one_of(st.just(float("nan")), st.floats(1.5, 2.5, width=32))),
    robot=arrays(F32, SHAPE, elements=st.one_of(st.just(float("nan")), st.floats(1.5, 2.5, width=32))),
)
def test_masks_are_disjoint_and_cover_the_image(person: np.ndarray, depth: np.ndarray, robot: np.ndarray) -> None:
    masks = segment(
        person=person,
        depth=depth,
        robot_depth=robot,
        height_in_base=2.0 - depth.astype(float),
        bed_height_in_base_m=0.0,
    )
    assert (sum(mask.astype(int) for mask in masks.values()) == 1).all()
    assert not (masks["human"] & np.isnan(depth)).any()
