from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from carecontact.episode.perception import PerceptionLog, iou, true_target
from carecontact.human.skeleton import body_name
from carecontact.interface.body_view import LANDMARK, region_from_observation
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import PANDA
from carecontact.protocol.load import load_protocol
from carecontact.recording.notes import JOINTS, PERCEPTION
from carecontact.recording.schema import OPTIONAL_ARRAYS
from carecontact.sensing.blazepose import LANDMARK_COUNT
from carecontact.sensing.builder import ObservationBuilder
from carecontact.sensing.keypoints import PoseEstimator, no_person, unrotate
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.room import FURNITURE_GROUP, SUPPORT
from carecontact.world.scene import build_scene


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_unrotate_finds_the_marked_pixel(turns: int) -> None:
    image = np.zeros((5, 9))
    image[1, 6] = 1
    v, u = np.argwhere(np.rot90(image, turns))[0]
    np.testing.assert_array_equal(unrotate(np.array([[u, v]], float), turns, 5, 9), [[6, 1]])


class Bright:
    """What OnePixelPose finds, with the fields of ``Found`` that are read."""

    def __init__(self, uv: np.ndarray, mask: np.ndarray) -> None:
        self.uv, self.mask, self.visibility = uv, mask, np.full(LANDMARK_COUNT, 0.9, np.float32)


class OnePixelPose:
    """Stands for BlazePose: puts every landmark on the brightest pixel and calls bright pixels a person."""

    def __init__(self, *, blind_below_px: int = 0) -> None:
        self.blind_below_px = blind_below_px
        self.sizes: list[tuple[int, int]] = []

    def find(self, rgb: np.ndarray) -> Bright | None:
        height, width = rgb.shape[:2]
        self.sizes.append((height, width))
        if rgb.max() == 0 or min(height, width) < self.blind_below_px:
            return None
        spots = np.argwhere(rgb[..., 0] > 100)
        uv = spots[np.arange(LANDMARK_COUNT) % len(spots), ::-1] + 0.5
        mask = (rgb[..., 0] > 100).astype(np.float32)
        return Bright(uv, mask)


def estimator(pose: OnePixelPose) -> PoseEstimator:
    made = PoseEstimator()
    made._pose = pose  # pyright: ignore[reportAttributeAccessIssue]
    return made


def spot_image() -> np.ndarray:
    image = np.zeros((60, 80, 3), np.uint8)
    image[20, 50] = 255
    return image


def test_votes_and_crop_map_back_to_the_image() -> None:
    pose = OnePixelPose()
    found = estimator(pose).estimate(spot_image())
    np.testing.assert_allclose(found.landmarks, np.tile([50, 20, 0.9], (LANDMARK_COUNT, 1)), atol=1e-4)
    assert np.argwhere(found.person > 0.5).tolist() == [[20, 50]]
    assert len(pose.sizes) == 6


def test_a_failed_second_pass_keeps_the_first() -> None:
    pose = OnePixelPose(blind_below_px=30)
    found = estimator(pose).estimate(spot_image())
    np.testing.assert_allclose(found.landmarks[0], [50, 20, 0.9], atol=1e-4)


def test_no_person() -> None:
    found = estimator(OnePixelPose()).estimate(np.zeros((60, 80, 3), np.uint8))
    assert np.isnan(found.landmarks).all()
    assert not found.person.any()
    assert no_person(4, 5).person.shape == (4, 5)


# The default estimator on the rendered person: the one test that runs the networks and the real scene.

ARM = {"right shoulder": "right_upper_arm", "right elbow": "right_forearm", "right wrist": "right_hand"}


@pytest.fixture(scope="module")
def seen() -> Iterator[tuple[Simulation, SceneRenderer, Observation]]:
    protocol = load_protocol("bathing-v3")
    simulation = Simulation(build_scene(protocol, target="forearm"))
    simulation.settle(52.5)
    mujoco.mj_forward(simulation.model, simulation.data)
    card = PolicyCard(name="test", modalities=("rgb", "depth", "points", "masks", "landmarks"))
    with SceneRenderer(simulation.model, protocol=protocol) as renderer:
        builder = ObservationBuilder(renderer, card, protocol, PoseEstimator())
        yield simulation, renderer, builder.build(simulation.data, instruction="", sim_time_s=0.0)


def test_right_arm_key_points(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    simulation, renderer, observation = seen
    view = observation.cameras["overhead"]
    assert view.landmarks is not None
    for name, segment in ARM.items():
        centre = simulation.data.body(body_name(segment)).xpos
        in_base = renderer.proprioception.in_base(simulation.data, centre, np.eye(3))[:3, 3]
        in_camera = view.pose_camera_in_base[:3, :3].T @ (in_base - view.pose_camera_in_base[:3, 3])
        uv = (view.intrinsics @ in_camera)[:2] / in_camera[2]
        assert np.linalg.norm(view.landmarks[LANDMARK[name], :2] - uv) < 10
        assert view.landmarks[LANDMARK[name], 2] > 0.8


@pytest.mark.parametrize("region", ["forearm", "upper_arm", "abdomen"])
def test_regions_are_where_they_are(seen: tuple[Simulation, SceneRenderer, Observation], region: str) -> None:
    simulation, renderer, observation = seen
    found = region_from_observation(observation, region)  # pyright: ignore[reportArgumentType]
    log = PerceptionLog(simulation.model, renderer)
    joints, skin = log.joints_in_base(simulation.data), log.skin_in_base(simulation.data)
    centre, along = true_target(region, joints, skin, simulation.model.skin_face)
    across = np.array([-along[1], along[0], 0.0])
    away = np.abs((found.centre_m - centre) @ np.stack([along, across, [0, 0, 1]], 1))
    assert (away < [0.03, 0.02, 0.01]).all()
    site = simulation.data.site(f"region_{region}")
    frame = renderer.proprioception.in_base(simulation.data, site.xpos, site.xmat)
    assert found.axis @ frame[:3, 0] > np.cos(np.radians(12))


def test_the_robot_is_filtered_out(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    _, _, observation = seen
    masks = observation.cameras["overhead"].masks
    assert masks is not None
    assert masks["robot"].sum() > 1000
    # The person covers 8 to 25 % of the overhead image.
    assert 0.08 < masks["human"].mean() < 0.25


def test_the_human_mask_is_the_person_without_the_pillow(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    simulation, renderer, observation = seen
    masks = observation.cameras["overhead"].masks
    assert masks is not None
    assert iou(masks["human"], renderer.truth(simulation.data, "overhead").human) > 0.97


def test_calibration_knows_nothing_of_the_person(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    simulation, _, observation = seen
    protocol, model, angles = simulation.protocol, simulation.model, observation.joint_position
    scrambled = copy.deepcopy(model)
    person = np.setdiff1d(np.arange(model.nq), [model.joint(name).qposadr[0] for name in PANDA.joints])
    rng = np.random.default_rng(0)
    with SceneRenderer(model, protocol=protocol) as one, SceneRenderer(scrambled, protocol=protocol) as other:
        # Not even through the state that a fresh copy of the world begins with.
        scrambled.qpos0[person] = rng.uniform(-1, 1, len(person))
        known = other.at_encoders(angles)
        # Hinges count from qpos0: only another angle than that one moves them.
        known.qpos[person] = rng.uniform(-1, 1, len(person))
        assert len(person) > 20
        for camera in ("overhead", "wrist"):
            np.testing.assert_array_equal(one.cell_depth(angles, camera), other.cell_depth(angles, camera))
            np.testing.assert_array_equal(one.robot_depth(angles, camera), other.robot_depth(angles, camera))
    shown = {model.body(int(b)).name for b in model.geom_bodyid[model.geom_group == FURNITURE_GROUP]}
    assert shown == {"world", SUPPORT}
    # The control: what was scrambled moved all that a person is.
    bodies = [b for b in range(model.nbody) if model.body(b).name.startswith("human_")]
    assert (np.abs(known.xpos[bodies] - simulation.data.xpos[bodies]) > 0.01).any(1).all()
    assert model.body(SUPPORT).weldid == 0, "pillow and board stand where they were put, whatever the person does"


def test_errors_are_measured_beside_the_observation(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    simulation, renderer, observation = seen
    before = renderer.renders["truth"]
    log = PerceptionLog(simulation.model, renderer)
    log.add(simulation.data, replace(observation, cameras={}))
    assert log.arrays() == {}
    log.add(simulation.data, observation)
    assert renderer.renders["truth"] == before + 1
    rows = log.arrays()
    assert {path: a.dtype.str[1:] for path, a in rows.items()} == {
        path: OPTIONAL_ARRAYS[path][0] for path in PERCEPTION
    }
    sizes = {
        "perception/joint_visible": (12,),
        "perception/landmark_error_px": (12,),
        "perception/target_error_m": (3, 3),
    }
    assert {path: a.shape[1:] for path, a in rows.items()} == dict.fromkeys(PERCEPTION, ()) | sizes
    assert rows["perception/observation_index"].tolist() == [1]
    assert rows["perception/joint_visible"][0, list(JOINTS).index("right elbow")]
    assert np.nanmedian(rows["perception/landmark_error_px"]) < 8
    assert np.linalg.norm(rows["perception/target_error_m"], axis=-1).max() < 0.05


def test_a_shifted_estimate_is_seen_as_an_error(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    simulation, renderer, observation = seen
    view = observation.cameras["overhead"]
    assert view.landmarks is not None
    assert view.masks is not None
    moved = replace(
        view,
        landmarks=view.landmarks + np.float32([30, 40, 0]),
        masks={name: np.roll(mask, 40, axis=0) for name, mask in view.masks.items()},
    )
    log = PerceptionLog(simulation.model, renderer)
    log.add(simulation.data, replace(observation, cameras={"overhead": moved}))
    assert np.nanmedian(log.arrays()["perception/landmark_error_px"]) > 40
    assert log.arrays()["perception/human_iou"][0] < 0.8
