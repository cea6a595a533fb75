"""The default estimator on the rendered person: the one test that runs MediaPipe and the real scene."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.observation.builder import ObservationBuilder
from carecontact.observation.keypoints import MediaPipePose
from carecontact.policies.state_machine.geometry import LANDMARK, region_from_observation
from carecontact.protocols import load_protocol
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import build_scene

JOINTS = {"right shoulder": "right_upper_arm", "right elbow": "right_forearm", "right wrist": "right_hand"}


@pytest.fixture(scope="module")
def seen() -> Iterator[tuple[Simulation, SceneRenderer, Observation]]:
    protocol = load_protocol()
    simulation = Simulation(build_scene(protocol, target="forearm"))
    simulation.settle(52.5)
    mujoco.mj_forward(simulation.model, simulation.data)
    card = PolicyCard(name="test", modalities=("rgb", "depth", "points", "masks", "landmarks"))
    keypoints = MediaPipePose()
    with SceneRenderer(simulation.model, protocol=protocol) as renderer:
        builder = ObservationBuilder(renderer, card, protocol, keypoints)
        yield simulation, renderer, builder.build(simulation.data, instruction="", sim_time_s=0.0)
    keypoints.close()


def test_right_arm_key_points(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    simulation, renderer, observation = seen
    view = observation.cameras["overhead"]
    assert view.landmarks is not None
    for name, segment in JOINTS.items():
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
    site = simulation.data.site(f"region_{region}")
    frame = renderer.proprioception.in_base(simulation.data, site.xpos, site.xmat)
    offset = frame[:3, :3].T @ (found.centre_m - frame[:3, 3])
    # The frame is at half the bone's length, the free upper arm's middle is further on.
    assert abs(offset[0]) < 0.04
    assert abs(offset[1]) < 0.025
    assert found.axis @ frame[:3, 0] > np.cos(np.radians(12))


def test_the_robot_is_filtered_out(seen: tuple[Simulation, SceneRenderer, Observation]) -> None:
    _, _, observation = seen
    masks = observation.cameras["overhead"].masks
    assert masks is not None
    assert masks["robot"].sum() > 1000
    # The person covers 8 to 25 % of the overhead image.
    assert 0.08 < masks["human"].mean() < 0.25
