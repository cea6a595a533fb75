from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from carecontact.contract.observation import MASK_NAMES, MODALITIES, CameraView, Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Variation
from carecontact.errors import ObservationError
from carecontact.hosting.wire import codec
from carecontact.hosting.wire.packing import pack
from carecontact.observation.builder import (
    ALLOWED,
    ALLOWED_IN_VIEW,
    ObservationBuilder,
    RawView,
    assemble,
    derive,
    derive_view,
)
from carecontact.observation.keypoints import KeyPoints
from carecontact.observation.pointcloud import coloured_cloud, organised_points
from carecontact.observation.sensor_noise import SensorNoise
from carecontact.protocols import load_protocol

H, W = 48, 64
INTRINSICS = np.array([[60.0, 0, (W - 1) / 2], [0, 60.0, (H - 1) / 2], [0, 0, 1]])
DOWN = np.array([[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]], float)


class FakeKeypoints:
    def __init__(self) -> None:
        self.calls = 0

    def estimate(self, rgb: np.ndarray) -> KeyPoints:
        self.calls += 1
        person = np.zeros((H, W), np.float32)
        person[10:30, 20:40] = 1
        return KeyPoints(landmarks=np.tile(np.float32([30, 20, 0.9]), (33, 1)), person=person)


class FakeRobot:
    def joint_position(self, data: Any) -> np.ndarray:
        return np.arange(7.0)

    def joint_velocity(self, data: Any) -> np.ndarray:
        return np.zeros(7)

    def pose_tcp_in_base(self, data: Any) -> np.ndarray:
        pose = np.eye(4)
        pose[:3, 3] = [0.4, 0.0, 0.3]
        return pose


class FakeRenderer:
    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.proprioception = FakeRobot()

    def rgb(self, data: Any, camera: str) -> np.ndarray:
        self.asked.append(("rgb", camera))
        return np.full((H, W, 3), 90, np.uint8)

    def depth(self, data: Any, camera: str) -> np.ndarray:
        self.asked.append(("depth", camera))
        depth = np.full((H, W), 2.0, np.float32)
        depth[10:30, 20:40] = 1.8
        return depth

    def robot_depth(self, joint_position: np.ndarray, camera: str) -> np.ndarray:
        self.asked.append(("robot_depth", camera))
        np.testing.assert_array_equal(joint_position, np.arange(7.0))
        robot = np.full((H, W), np.nan, np.float32)
        robot[:, :5] = 2.0
        return robot

    def cell_depth(self, joint_position: np.ndarray, camera: str) -> np.ndarray:
        self.asked.append(("cell_depth", camera))
        np.testing.assert_array_equal(joint_position, np.arange(7.0))
        return np.full((H, W), 2.0, np.float32)

    def at_encoders(self, joint_position: np.ndarray) -> None:
        np.testing.assert_array_equal(joint_position, np.arange(7.0))

    def intrinsics(self, camera: str) -> np.ndarray:
        return INTRINSICS

    def pose_camera_in_base(self, data: Any, camera: str) -> np.ndarray:
        return DOWN


def build(modalities: tuple[str, ...], cameras: tuple[str, ...] = ("overhead",)) -> tuple[Observation, FakeRenderer]:
    renderer = FakeRenderer()
    card = PolicyCard(name="test", modalities=modalities, cameras=cameras)
    made = ObservationBuilder(
        renderer,  # pyright: ignore[reportArgumentType]
        card,
        load_protocol(),
        FakeKeypoints(),
    )
    return made.build(None, instruction="touch", sim_time_s=0.5), renderer  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("modalities", "images"),
    [
        ((), set()),
        (("rgb",), {"rgb"}),
        (("depth",), {"depth"}),
        (("points",), {"rgb", "depth"}),
        (("landmarks",), {"rgb", "depth"}),
        (("masks",), {"rgb", "depth", "robot_depth", "cell_depth"}),
    ],
)
def test_only_what_the_card_names_is_rendered_and_sent(modalities: tuple[str, ...], images: set[str]) -> None:
    observation, renderer = build(modalities)
    assert {kind for kind, _ in renderer.asked} == images
    assert len(renderer.asked) == len(images)
    view = observation.cameras["overhead"]
    named = {name for name in MODALITIES if getattr(view, name) is not None}
    assert named == set(modalities)


def test_cameras_that_are_not_named_are_not_rendered() -> None:
    observation, renderer = build(("rgb",), ("wrist", "bedside"))
    assert renderer.asked == [("rgb", "wrist"), ("rgb", "bedside")]
    assert set(observation.cameras) == {"wrist", "bedside"}


def test_everything_together() -> None:
    observation, _ = build(MODALITIES)
    view = observation.cameras["overhead"]
    assert view.masks is not None
    assert set(view.masks) == set(MASK_NAMES)
    assert view.masks["human"].sum() == 20 * 20
    assert view.masks["robot"].sum() == 5 * H
    assert view.points is not None
    assert view.points.shape == (H * W, 3)
    assert view.landmarks_in_base is not None
    np.testing.assert_allclose(
        view.landmarks_in_base[0], [(23.5 - 20) * 1.8 / 60, (31.5 - 30) * 1.8 / 60, 0.2], atol=1e-6
    )
    np.testing.assert_allclose(observation.pose_tcp_in_base, [0.4, 0, 0.3, 1, 0, 0, 0])
    np.testing.assert_array_equal(observation.gripper_position, [0.0])
    assert (observation.instruction, observation.sim_time_s) == ("touch", 0.5)


def test_masks_and_landmarks_share_one_estimate() -> None:
    keypoints = FakeKeypoints()
    renderer = FakeRenderer()
    raw = RawView(
        intrinsics=INTRINSICS,
        pose_camera_in_base=DOWN,
        rgb=renderer.rgb(None, "overhead"),
        depth=renderer.depth(None, "overhead"),
        robot_depth=renderer.robot_depth(np.arange(7.0), "overhead"),
        cell_depth=renderer.cell_depth(np.arange(7.0), "overhead"),
    )
    derive_view(raw, modalities=("masks", "landmarks"), keypoints=keypoints)
    assert keypoints.calls == 1


class FakeSegmenter:
    def person(self, rgb: np.ndarray) -> np.ndarray:
        person = np.zeros((H, W), np.float32)
        person[10:30, 20:24] = 1
        return person


@pytest.mark.parametrize(("modalities", "calls"), [(("masks",), 0), (("masks", "landmarks"), 1)])
def test_a_segmenter_stands_in_for_the_estimators_mask_alone(modalities: tuple[str, ...], calls: int) -> None:
    keypoints, renderer = FakeKeypoints(), FakeRenderer()
    card = PolicyCard(name="test", modalities=modalities)
    made = ObservationBuilder(renderer, card, load_protocol(), keypoints, segmenter=FakeSegmenter())  # pyright: ignore[reportArgumentType]
    view = made.build(None, instruction="", sim_time_s=0.0).cameras["overhead"]  # pyright: ignore[reportArgumentType]
    assert keypoints.calls == calls
    assert (view.landmarks is not None) == (calls == 1)
    assert view.masks is not None
    # Grown by 5 px and cut where nothing is nearer than the empty cell: left of column 20.
    assert view.masks["human"].any(0).nonzero()[0].tolist() == list(range(20, 29))


def test_a_missing_image_is_an_error() -> None:
    raw = RawView(intrinsics=INTRINSICS, pose_camera_in_base=DOWN, rgb=np.zeros((H, W, 3), np.uint8))
    with pytest.raises(ObservationError, match="depth"):
        derive_view(raw, modalities=("landmarks",), keypoints=FakeKeypoints())


def test_the_allowlist_is_the_contract() -> None:
    assert {f.name for f in fields(Observation)} == ALLOWED
    assert {f.name for f in fields(CameraView)} == ALLOWED_IN_VIEW


@pytest.mark.parametrize("key", ["contact_force", "seed", "human_joint_position", "qpos"])
def test_a_privileged_key_is_refused(key: str) -> None:
    with pytest.raises(ObservationError, match=key):
        assemble({"instruction": "", key: 0}, {})
    with pytest.raises(ObservationError, match=f"camera overhead: {key}"):
        assemble({"instruction": ""}, {"overhead": {key: 0}})


def test_readings_alone_give_the_observation_again() -> None:
    renderer, card = FakeRenderer(), PolicyCard(name="test", modalities=MODALITIES)
    made = ObservationBuilder(renderer, card, load_protocol(), FakeKeypoints())  # pyright: ignore[reportArgumentType]
    assert made.raw is None
    seen = made.build(None, instruction="touch", sim_time_s=0.5)  # pyright: ignore[reportArgumentType]
    assert made.raw is not None
    again = derive(
        made.raw,
        instruction="touch",
        sim_time_s=0.5,
        modalities=MODALITIES,
        keypoints=FakeKeypoints(),
    )
    assert pack(codec.encode_observation(again)) == pack(codec.encode_observation(seen))


def test_noise_comes_before_everything_that_is_made_of_depth() -> None:
    protocol, renderer = load_protocol(), FakeRenderer()
    card = PolicyCard(name="test", modalities=MODALITIES)
    noise = SensorNoise(Variation(depth_noise="structured-light-v1"), key=[5], dt_s=0.002)
    made = ObservationBuilder(renderer, card, protocol, FakeKeypoints(), noise=noise)  # pyright: ignore[reportArgumentType]
    view = made.build(None, instruction="", sim_time_s=0.0).cameras["overhead"]  # pyright: ignore[reportArgumentType]
    assert view.depth is not None
    assert view.points is not None
    clean = renderer.depth(None, "overhead")
    assert (view.depth != clean).mean() > 0.5
    expected, _ = coloured_cloud(organised_points(view.depth, INTRINSICS, DOWN), np.zeros((H, W, 3), np.uint8))
    np.testing.assert_array_equal(view.points, expected)
    again = made.build(None, instruction="", sim_time_s=0.0).cameras["overhead"]  # pyright: ignore[reportArgumentType]
    np.testing.assert_array_equal(view.depth, again.depth)
