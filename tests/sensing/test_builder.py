from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ObservationError
from carecontact.interface.observation import MASK_NAMES, MODALITIES, CameraView, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.sections import Variation
from carecontact.sensing.builder import (
    ALLOWED,
    ALLOWED_IN_VIEW,
    SPEED_PER_ANGLE,
    ObservationBuilder,
    RawView,
    SensorNoise,
    assemble,
    back_project,
    coloured_cloud,
    derive,
    derive_view,
    organised_points,
    structured_light,
    surface_under,
)
from carecontact.sensing.keypoints import KeyPoints
from carecontact.serving import codec
from carecontact.serving.packing import pack

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
        load_protocol("bathing-v3"),
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
    made = ObservationBuilder(renderer, card, load_protocol("bathing-v3"), keypoints, segmenter=FakeSegmenter())  # pyright: ignore[reportArgumentType]
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
    # An observation gives each view its time, so that no builder can give it another.
    assert {f.name for f in fields(CameraView)} - {"sim_time_s"} == ALLOWED_IN_VIEW


@pytest.mark.parametrize("key", ["contact_force", "seed", "human_joint_position", "qpos"])
def test_a_privileged_key_is_refused(key: str) -> None:
    with pytest.raises(ObservationError, match=key):
        assemble({"instruction": "", key: 0}, {})
    with pytest.raises(ObservationError, match=f"camera overhead: {key}"):
        assemble({"instruction": ""}, {"overhead": {key: 0}})


def test_readings_alone_give_the_observation_again() -> None:
    renderer, card = FakeRenderer(), PolicyCard(name="test", modalities=MODALITIES)
    made = ObservationBuilder(renderer, card, load_protocol("bathing-v3"), FakeKeypoints())  # pyright: ignore[reportArgumentType]
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
    protocol, renderer = load_protocol("bathing-v3"), FakeRenderer()
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


POINTCLOUD_INTRINSICS = np.array([[100.0, 0, 31.5], [0, 100.0, 23.5], [0, 0, 1]])
# 2 m over the base's origin, looking straight down: image right is base -y, image down is base -x.
DOWN_POINTCLOUD = np.array([[0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]], float)


def test_known_pixels() -> None:
    points = back_project(
        [[31.5, 23.5], [41.5, 23.5], [31.5, 3.5]], [2.0, 1.5, 2.0], POINTCLOUD_INTRINSICS, DOWN_POINTCLOUD
    )
    np.testing.assert_allclose(points, [[0, 0, 0], [0, -0.15, 0.5], [0.4, 0, 0]], atol=1e-12)


@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3), z=st.floats(0.0, 1.0))
def test_projection_is_undone(x: float, y: float, z: float) -> None:
    in_camera = DOWN_POINTCLOUD[:3, :3].T @ (np.array([x, y, z]) - DOWN_POINTCLOUD[:3, 3])
    uv = (POINTCLOUD_INTRINSICS @ in_camera)[:2] / in_camera[2]
    np.testing.assert_allclose(
        back_project(uv, in_camera[2], POINTCLOUD_INTRINSICS, DOWN_POINTCLOUD), [x, y, z], atol=1e-9
    )


def test_the_cloud_leaves_out_pixels_without_depth() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[0, :10] = np.nan
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[0, 10] = 7
    points, colors = coloured_cloud(organised_points(depth, POINTCLOUD_INTRINSICS, DOWN_POINTCLOUD), rgb)
    assert points.shape == colors.shape == (48 * 64 - 10, 3)
    assert (colors[0] == 7).all()
    np.testing.assert_allclose(points[:, 2], 0, atol=1e-6)


def test_surface_under_landmarks() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[20:28, 28:36] = 1.5
    limb = depth < 1.9
    landmarks = np.array([[31.5, 23.5, 1], [38.0, 23.5, 1], [5, 5, 1], [80, 5, 1], [np.nan] * 3], np.float32)
    surface = surface_under(landmarks, depth, POINTCLOUD_INTRINSICS, DOWN_POINTCLOUD, where=limb)
    np.testing.assert_allclose(surface[0], [0, 0, 0.5], atol=1e-6)
    # Two pixels beside the limb the wider window still finds it; far away nothing does.
    np.testing.assert_allclose(surface[1], [0, -6.5 * 1.5 / 100, 0.5], atol=1e-6)
    assert np.isnan(surface[2:]).all()
    anywhere = surface_under(landmarks, depth, POINTCLOUD_INTRINSICS, DOWN_POINTCLOUD, where=None)
    assert np.isfinite(anywhere[2]).all()
    assert np.isnan(anywhere[3:]).all()


SENSOR_NOISE_INTRINSICS = np.array([[433.0, 0, 319.5], [0, 433.0, 239.5], [0, 0, 1]])
ON = Variation(depth_noise="structured-light-v1", encoder_noise_rad=0.003)


def wall(distance_m: float) -> np.ndarray:
    return np.full((480, 640), distance_m, np.float32)


@pytest.mark.parametrize(("distance_m", "sigma_m"), [(1.0, 0.0019), (2.0, 0.0061), (3.0, 0.0140)])
def test_noise_grows_as_published(distance_m: float, sigma_m: float) -> None:
    seen = structured_light(wall(distance_m), SENSOR_NOISE_INTRINSICS, np.random.default_rng(0))
    step = 2.85e-3 * distance_m**2
    expected = np.hypot(sigma_m, step / np.sqrt(12))
    assert np.std(seen) == pytest.approx(expected, rel=0.1)
    assert abs(np.mean(seen) - distance_m) < 0.25 * step
    assert np.diff(np.unique(seen)).min() == pytest.approx(step, rel=0.1)


def test_edges_and_grazing_surfaces_have_no_depth() -> None:
    depth = wall(2.0)
    depth[:, 320:] = 1.7
    depth[0] = np.nan
    seen = structured_light(depth, SENSOR_NOISE_INTRINSICS, np.random.default_rng(0))
    assert np.isnan(seen[:, 319:321]).all()
    assert np.isnan(seen[0]).all()
    assert np.isfinite(seen[10:, :310]).all()
    # A floor seen along itself: x = 0.05 (z - 1), 87 deg from its normal.
    u = np.arange(640) - 319.5
    floor = np.tile(np.float32(0.05 / (0.05 - np.clip(u / 433, -1, 0.04))), (480, 1))
    assert np.isnan(structured_light(floor, SENSOR_NOISE_INTRINSICS, np.random.default_rng(0))[:, 300:330]).mean() > 0.9


def test_same_moment_and_camera_same_noise() -> None:
    noise, again, other = (SensorNoise(ON, key=key, dt_s=0.002) for key in ([1, 2], [1, 2], [1, 3]))

    def depth(source: SensorNoise, camera: str, time_s: float) -> np.ndarray:
        return source.depth(wall(2.0), SENSOR_NOISE_INTRINSICS, camera=camera, sim_time_s=time_s)

    first = depth(noise, "overhead", 0.5)
    depth(again, "wrist", 0.1)  # what was asked before does not matter
    np.testing.assert_array_equal(depth(again, "overhead", 0.5), first)
    for source, camera, time_s in ((noise, "overhead", 0.502), (noise, "bedside", 0.5), (other, "overhead", 0.5)):
        assert (depth(source, camera, time_s) != first).mean() > 0.3


def test_encoders() -> None:
    noise, angles = SensorNoise(ON, key=[1], dt_s=0.002), np.arange(7.0)
    read = np.array([noise.joint_position(angles, sim_time_s=k * 0.002) - angles for k in range(500)])
    assert read.std() == pytest.approx(0.003, rel=0.05)
    np.testing.assert_array_equal(noise.joint_position(angles, sim_time_s=0.002) - angles, read[1])
    moving = np.array([noise.joint_velocity(angles, sim_time_s=k * 0.002) - angles for k in range(500)])
    assert moving.std() == pytest.approx(0.003 * SPEED_PER_ANGLE, rel=0.05)
    assert abs(np.corrcoef(read.ravel(), moving.ravel())[0, 1]) < 0.05
    np.testing.assert_array_equal(noise.joint_velocity(angles, sim_time_s=0.002) - angles, moving[1])


def test_the_speed_s_noise_is_that_of_a_slope_behind_a_low_pass() -> None:
    """White noise on angles that are read a thousand times a second, as a controller would make a speed of it."""
    angle, cutoff, read_hz = np.random.default_rng(0).standard_normal(100_000), SPEED_PER_ANGLE, 1000.0
    smooth = np.zeros_like(angle)
    for k in range(1, len(angle)):
        smooth[k] = smooth[k - 1] + cutoff / read_hz * (angle[k] - smooth[k - 1])
    speed = cutoff * (angle - smooth)
    assert speed[1000:].std() == pytest.approx(SPEED_PER_ANGLE, rel=0.05)


def test_off_is_untouched() -> None:
    noise, depth, angles = SensorNoise(Variation(), key=(), dt_s=0.002), wall(2.0), np.arange(7.0)
    assert noise.depth(depth, SENSOR_NOISE_INTRINSICS, camera="overhead", sim_time_s=0.0) is depth
    assert noise.joint_position(angles, sim_time_s=0.0) is angles
    assert noise.joint_velocity(angles, sim_time_s=0.0) is angles
    assert not noise.on_encoders
