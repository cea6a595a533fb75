"""What a policy sees at t = 0, without running a trial."""

from __future__ import annotations

from pathlib import Path

from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Protocol
from carecontact.episode.prepare import settled_world
from carecontact.episode.randomization import sensor_noise
from carecontact.episode.vision import person_segmenter
from carecontact.observation.builder import ObservationBuilder
from carecontact.observation.keypoints import MediaPipePose
from carecontact.sim.rendering import SceneRenderer


def first_look(
    protocol: Protocol, *, task_id: str, seed: int, card: PolicyCard, weights: Path | None = None
) -> Observation:
    """The first observation of the trial, for the modalities and cameras of the card. ``weights``: of the protocol's
    segmenter.

    Raises SceneError, SettleError and DependencyError as a trial does.
    """
    segmenter = person_segmenter(protocol, weights)
    simulation, _, _ = settled_world(protocol, task_id=task_id, seed=seed)
    simulation.start()
    keypoints = MediaPipePose()
    try:
        with SceneRenderer(simulation.model, protocol=protocol) as renderer:
            noise = sensor_noise(protocol, seed)
            builder = ObservationBuilder(renderer, card, protocol, keypoints, noise=noise, segmenter=segmenter)
            simulation.refresh()
            return builder.build(
                simulation.data, instruction=protocol.task(task_id).prompt, sim_time_s=simulation.time_s
            )
    finally:
        keypoints.close()
