"""What a policy sees at t = 0, without running a trial."""

from __future__ import annotations

from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Protocol
from carecontact.observation.builder import ObservationBuilder
from carecontact.observation.keypoints import MediaPipePose
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.settled import settle
from carecontact.sim.simulation import Simulation
from carecontact.trials.randomization import comfort_arm_deg, dress, sensor_noise
from carecontact.world.scene import build_scene


def first_look(protocol: Protocol, *, task_id: str, seed: int, card: PolicyCard) -> Observation:
    """The first observation of the trial, for the modalities and cameras of the card.

    Raises SceneError, SettleError and DependencyError as a trial does.
    """
    task = protocol.task(task_id)
    scene = build_scene(protocol, target=task.region)
    model_sha256 = scene.model_sha256
    dress(scene, seed)
    simulation = Simulation(scene)
    settle(simulation, comfort_arm_deg(protocol, seed), model_sha256=model_sha256)
    simulation.start()
    keypoints = MediaPipePose()
    try:
        with SceneRenderer(scene.model, protocol=protocol) as renderer:
            noise = sensor_noise(protocol, seed)
            builder = ObservationBuilder(renderer, card, protocol, keypoints, noise=noise)
            simulation.refresh()
            return builder.build(simulation.data, instruction=task.prompt, sim_time_s=simulation.time_s)
    finally:
        keypoints.close()
