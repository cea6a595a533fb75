"""The pose model against what MediaPipe 0.10.21 answered for the same pictures (tools/pose_reference.py)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.pictures import decoded
from carecontact.sensing import blazepose
from carecontact.sensing.blazepose import BlazePose, Found

Answer = tuple[np.ndarray, np.ndarray, Found | None]

REFERENCE = Path(__file__).parents[1] / "data" / "pose.npz"


@pytest.fixture(scope="module")
def answers() -> list[Answer]:
    """Landmarks (33, 3) and mask (H, W) of MediaPipe for each picture, and what this package finds in it."""
    pose, rows = BlazePose(), []
    with np.load(REFERENCE) as stored:
        for number, landmarks in enumerate(stored["landmarks"]):
            rgb = decoded(stored[f"jpeg_{number}"].tobytes())
            mask = np.unpackbits(stored["masks"][number])[: rgb[..., 0].size].reshape(rgb.shape[:2]).astype(bool)
            rows.append((landmarks, mask, pose.find(rgb)))
    return rows


def test_a_person_is_found_in_the_same_pictures(answers: list[Answer]) -> None:
    assert len(answers) == 40
    for landmarks, _, found in answers:
        assert (found is None) == bool(np.isnan(landmarks).any())


def test_landmarks_are_those_of_mediapipe(answers: list[Answer]) -> None:
    apart = np.array([np.hypot(*(landmarks[:, :2] - found.uv).T) for landmarks, _, found in answers if found])
    assert np.median(apart) < 0.02
    # A heatmap whose largest value is the least that counts moves its landmark with one release and not the other.
    assert np.quantile(apart, 0.99) < 1
    unlike = [np.abs(landmarks[:, 2] - found.visibility).max() for landmarks, _, found in answers if found]
    assert max(unlike) < 0.05


def test_masks_are_those_of_mediapipe(answers: list[Answer]) -> None:
    for _, mask, found in answers:
        assert found is not None
        ours = found.mask > 0.5
        assert (ours & mask).sum() > 0.98 * (ours | mask).sum()


def test_an_empty_picture_shows_no_person() -> None:
    assert BlazePose().find(np.full((120, 160, 3), 127, np.uint8)) is None


def test_every_cell_has_two_boxes_a_layer() -> None:
    cells = blazepose._cells()
    assert cells.shape == (2 * 28**2 + 2 * 14**2 + 6 * 7**2, 2)
    np.testing.assert_allclose(cells[[0, 1, 2]] * 224, [[4, 4], [4, 4], [12, 4]])
    np.testing.assert_allclose(cells[-1] * 224, [208, 208])


def test_a_sure_heatmap_moves_its_landmark_and_an_unsure_one_does_not() -> None:
    heat = np.full((64, 64, 39), -80.0, np.float32)
    for value, place in ((0.9, (20, 31, 0)), (0.3, (22, 31, 0)), (0.4, (20, 31, 1)), (0.9, (20, 60, 2))):
        heat[place] = np.log(value / (1 - value))
    uv = np.full((33, 2), (30 / 64, 19 / 64), np.float32)
    uv[3] = (1.2, 0.5)
    moved = blazepose._refined(uv, heat) * 64
    np.testing.assert_allclose(moved[0], [31, 20.5], atol=1e-5)
    np.testing.assert_allclose(moved[1:3], [[30, 19], [30, 19]], atol=1e-4)
    np.testing.assert_allclose(moved[3], [1.2 * 64, 32], atol=1e-4)


def test_a_square_of_the_image_is_drawn_where_it_lies() -> None:
    image = np.arange(40 * 60 * 3, dtype=np.uint16).reshape(40, 60, 3).astype(np.uint8)
    square = blazepose.Square(middle=np.array([34.0, 15.0]), side=10.0, angle=np.pi / 2)
    drawn = blazepose._sampled(framed(image), square.to_image(10), 10)
    np.testing.assert_array_equal(drawn, np.rot90(image[10:20, 30:40]))


def test_between_pixels_and_beyond_the_border_a_square_is_interpolated() -> None:
    image = np.full((4, 4, 3), 100, np.uint8)
    image[:, 2:] = 200
    moved = np.array([[1, 0, 0.5], [0, 1, 0.25]])
    assert blazepose._sampled(framed(image), moved, 5)[0, :, 0].tolist() == [100, 150, 200, 100, 0]
    assert blazepose._sampled(framed(image, "edge"), moved, 5)[4, :, 0].tolist() == [100, 150, 200, 200, 200]


def framed(image: np.ndarray, mode: str = "constant") -> np.ndarray:
    return np.pad(np.pad(image, ((1, 1), (1, 1), (0, 0)), mode), ((0, 0), (0, 0), (0, 1)))  # pyright: ignore[reportCallIssue, reportArgumentType]
