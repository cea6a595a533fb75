from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carecontact.errors import ConfigError
from carecontact.interface.observation import MASK_NAMES
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.recording.provenance import package_versions
from carecontact.sensing import grounded_sam, segmentation
from carecontact.sensing.calibration import draw_calibration
from carecontact.sensing.grounded_sam import MODELS, person_segmenter, weights_sha256
from carecontact.sensing.segmentation import bed_plane, robot_mask, segment

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


def test_no_person_found_is_an_empty_mask() -> None:
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


def test_where_no_person_is_seen_there_is_no_bed() -> None:
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


PROTOCOL = load_protocol("bathing-v3")


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    for name in MODELS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text(json.dumps({"model_type": name}))
        (tmp_path / name / "model.safetensors").write_bytes(b"weights")
    return tmp_path


def with_sam(sha256: str) -> Protocol:
    return overridden(PROTOCOL, {"vision.segmenter": "grounded-sam", "vision.weights_sha256": sha256})


def test_the_default_needs_no_segmenter(weights: Path) -> None:
    assert person_segmenter(PROTOCOL, weights) is None


def test_the_weights_are_those_that_the_protocol_names(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[Path] = []
    monkeypatch.setattr(grounded_sam, "GroundedSam", loaded.append)
    protocol = with_sam(weights_sha256(weights))
    with pytest.raises(ConfigError, match="names the segmenter grounded-sam, whose --weights are missing"):
        person_segmenter(protocol)
    person_segmenter(protocol, weights)
    assert loaded == [weights]
    (weights / "sam" / "model.safetensors").write_bytes(b"others")
    with pytest.raises(ConfigError, match=r"these weights have sha256 [0-9a-f]{12}, the protocol names [0-9a-f]{12}"):
        person_segmenter(protocol, weights)
    assert loaded == [weights]


def test_a_recording_names_what_the_segmenter_runs_on() -> None:
    assert set(package_versions("grounded-sam")) - set(package_versions()) == {
        "torch",
        "transformers",
        "tokenizers",
    }


def erring(shift_m: float, turn_deg: float) -> Protocol:
    protocol = load_protocol("bathing-v3")
    varied = protocol.variation.model_copy(update={"calibration_m": shift_m, "calibration_deg": turn_deg})
    return protocol.model_copy(update={"variation": varied})


def test_without_an_error_no_camera_has_one() -> None:
    assert draw_calibration(np.random.default_rng(0), load_protocol("bathing-v3")) == {}


def test_every_fixed_camera_errs_as_the_protocol_says_and_the_hands_does_not() -> None:
    draws = [draw_calibration(np.random.default_rng(k), erring(0.003, 0.2)) for k in range(400)]
    assert {frozenset(found) for found in draws} == {frozenset(("overhead", "bedside", "exterior"))}
    errors = np.array([list(found.values()) for found in draws])
    np.testing.assert_allclose(errors[..., :3, 3].std((0, 1)), 0.003, rtol=0.08)
    turn = np.degrees(np.stack([errors[..., 2, 1], errors[..., 0, 2], errors[..., 1, 0]], -1))
    np.testing.assert_allclose(turn.std((0, 1)), 0.2, rtol=0.08)
    gram = errors[..., :3, :3] @ errors[..., :3, :3].swapaxes(-1, -2)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-12)
    flat = np.concatenate([errors[..., :3, 3].reshape(len(draws), -1), turn.reshape(len(draws), -1)], 1)
    assert np.abs(np.corrcoef(flat.T) - np.eye(18)).max() < 0.25


def test_a_camera_has_the_same_error_whichever_others_there_are() -> None:
    protocol = erring(0.003, 0.2)
    alone = protocol.model_copy(update={"cameras": {"exterior": protocol.cameras["exterior"]}})
    found = draw_calibration(np.random.default_rng(5), alone)
    assert list(found) == ["exterior"]
    np.testing.assert_array_equal(found["exterior"], draw_calibration(np.random.default_rng(5), protocol)["exterior"])
