"""The world of one trial up to t = 0, for running it and for looking at it."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.episode.randomization import comfort_arm_deg, dress, lay
from carecontact.sim.settled import settle
from carecontact.sim.simulation import Settled, Simulation
from carecontact.world.scene import build_scene


def settled_world(protocol: Protocol, *, task_id: str, seed: int) -> tuple[Simulation, Settled, str]:
    """Built, dressed as the seed says and settled; how it settled, and the sha256 of the model before both.

    Raises SceneError or SettleError.
    """
    scene = build_scene(protocol, target=protocol.task(task_id).region)
    # Before anything is changed: looks and place are the seed's, settling writes the seed's rest angles, a policy its
    # stiffness.
    model_sha256 = scene.model_sha256
    dress(scene, seed)
    lay(scene, seed)
    simulation = Simulation(scene)
    return simulation, settle(simulation, comfort_arm_deg(protocol, seed), model_sha256=model_sha256), model_sha256
