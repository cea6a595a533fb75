"""What a seed changes in a compiled world: appearance, light, place, movements of the person, noise. ``drawn`` has what
it draws before."""

from __future__ import annotations

from carecontact.contract.protocol import Alive, Protocol
from carecontact.episode.draws import STREAMS, streams, words
from carecontact.kernel.region import set_law
from carecontact.observation.calibration import Calibration, draw_calibration
from carecontact.observation.sensor_noise import SensorNoise
from carecontact.sim.simulation import Simulation
from carecontact.world.human.appearance import draw_appearance, wear
from carecontact.world.human.spread import draw_tissue
from carecontact.world.life import draw_doings
from carecontact.world.light import draw_light, shine
from carecontact.world.place import UNMOVED, Place, move_person
from carecontact.world.scene import Scene

__all__ = ["STREAMS", "calibration", "comfort_arm_deg", "dress", "lay", "sensor_noise", "soften", "streams", "wake"]


def comfort_arm_deg(protocol: Protocol, seed: int, *, salt: str = "") -> float:
    """Return the arm's angle [deg] of the seed's first draw of a person; a protocol that parks the robot may reject
    that person (``drawn``).
    """
    low, high = protocol.randomization.comfort_arm_deg
    return float(streams(protocol, seed, salt)["comfort_arm"].uniform(low, high))


def dress(scene: Scene, seed: int, *, salt: str = "") -> None:
    """Give a compiled scene the appearance and light that its protocol varies with the seed; the physics is unchanged.

    Call it once, before the first image.
    """
    protocol, stream = scene.protocol, streams(scene.protocol, seed, salt)
    if protocol.variation.appearance == "varied-v1":
        wear(scene.model, scene.body, draw_appearance(stream["appearance"]))
    if protocol.variation.light == "varied-v1":
        shine(scene.model, draw_light(stream["light"]))


def lay(scene: Scene, place: Place) -> None:
    """Put the person of a compiled scene where the seed's draw says (``episode.drawn``).

    Call it once, before the person settles.
    """
    if place != UNMOVED:
        move_person(scene.model, place)


def soften(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Give the soft regions of a settled world the stiffness that its protocol varies with the seed.

    Call it once. Nothing touches a soft region while the person settles, so that the stiffness does not change how
    the person lies.
    """
    scene = simulation.scene
    if scene.protocol.variation.tissue == "published-v1":
        rows = {name: region.tissue for name, region in scene.regions.items()}
        for name, row in draw_tissue(streams(scene.protocol, seed, salt)["tissue"], rows).items():
            set_law(simulation.model, name, row)


def wake(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Start the movements that a protocol lets the person of a settled world make on their own, if there are any."""
    protocol = simulation.protocol
    if simulation.life is None or protocol.person.alive == Alive():
        return
    doings = draw_doings(
        streams(protocol, seed, salt), protocol.person.alive, until_s=protocol.phases.time_limit_s,
        wrist_radius_m=simulation.wrist_radius_m(),
    )  # fmt: skip
    simulation.life.wake(simulation.data, doings)


def calibration(protocol: Protocol, seed: int, *, salt: str = "") -> Calibration:
    """Return the error with which the cell of one trial knows its fixed cameras."""
    return draw_calibration(streams(protocol, seed, salt)["calibration"], protocol)


def sensor_noise(protocol: Protocol, seed: int, *, salt: str = "", noise_salt: str = "") -> SensorNoise:
    """Return the sensor noise of one trial, which changes nothing if the protocol names no noise.

    ``noise_salt``: the trial's own. Without it, and without a ``salt``, the noise would reveal the seed.
    """
    key = streams(protocol, seed, salt)["sensor_noise"].integers(2**32, size=4).tolist()
    if noise_salt:
        # A hash works one way: not even the whole noise of a trial reveals salt or seed.
        key = words(f"{noise_salt} {key}")
    return SensorNoise(protocol.variation, key=key, dt_s=protocol.physics.dt_s)
