"""What a seed decides. Named streams, so that adding one never changes another."""

from __future__ import annotations

import hashlib

import numpy as np

from carecontact.contract.protocol import Alive, Protocol
from carecontact.kernel.region import set_law
from carecontact.observation.calibration import Calibration, draw_calibration
from carecontact.observation.sensor_noise import SensorNoise
from carecontact.sim.simulation import Simulation
from carecontact.world.human.appearance import draw_appearance, wear
from carecontact.world.human.spread import draw_tissue
from carecontact.world.life import draw_doings
from carecontact.world.light import draw_light, shine
from carecontact.world.place import draw_place, move_person
from carecontact.world.scene import Scene

STREAMS = ("comfort_arm", "appearance", "sensor_noise", "policy", "light", "place", "breathing", "repositioning",
           "withdrawal", "calibration", "tissue")  # fmt: skip
"""In the order of the seed's children: a new one goes to the end."""


def streams(protocol: Protocol, seed: int, salt: str) -> dict[str, np.random.Generator]:
    """One generator a stream; they depend on protocol id, seed and salt only, so trials are paired over tasks and
    methods.

    Args:
        salt: the trial's secret (``TrialSpec.salt``), without which nobody can tell from a published seed what it
            draws; empty for a run on published seeds.
    """
    if salt:
        # A hash for each stream, not a seed for all: whoever found out one stream from what it drew would know neither
        # the salt nor another stream.
        return {name: np.random.default_rng(_words(f"{salt} {protocol.id} {seed} {name}")) for name in STREAMS}
    children = np.random.SeedSequence([*_words(protocol.id), seed]).spawn(len(STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(STREAMS, children, strict=True)}


def _words(text: str) -> list[int]:
    return np.frombuffer(hashlib.sha256(text.encode()).digest(), "<u4").tolist()


def comfort_arm_deg(protocol: Protocol, seed: int, *, salt: str = "") -> float:
    low, high = protocol.randomization.comfort_arm_deg
    return float(streams(protocol, seed, salt)["comfort_arm"].uniform(low, high))


def dress(scene: Scene, seed: int, *, salt: str = "") -> None:
    """Give a compiled scene the appearance and light that its protocol varies with the seed; physics stays.

    Once, and before the first image.
    """
    protocol, stream = scene.protocol, streams(scene.protocol, seed, salt)
    if protocol.variation.appearance == "varied-v1":
        wear(scene.model, scene.body, draw_appearance(stream["appearance"]))
    if protocol.variation.light == "varied-v1":
        shine(scene.model, draw_light(stream["light"]))


def lay(scene: Scene, seed: int, *, salt: str = "") -> None:
    """Put the person of a compiled scene where its protocol varies the place with the seed.

    Once, and before the person settles.
    """
    variation = scene.protocol.variation
    if variation.place_along_m or variation.place_across_m or variation.place_yaw_deg:
        move_person(scene.model, draw_place(streams(scene.protocol, seed, salt)["place"], variation))


def soften(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Give the soft regions of a settled world the stiffness that its protocol varies with the seed.

    Once. Nothing touches a soft region while the person settles, so that all draws of a person lie in the same way.
    """
    scene = simulation.scene
    if scene.protocol.variation.tissue == "published-v1":
        rows = {name: region.tissue for name, region in scene.regions.items()}
        for name, row in draw_tissue(streams(scene.protocol, seed, salt)["tissue"], rows).items():
            set_law(simulation.model, name, row)


def wake(simulation: Simulation, seed: int, *, salt: str = "") -> None:
    """Let the person of a settled world begin what its protocol lets it do by itself; nothing where it does nothing."""
    protocol = simulation.protocol
    if simulation.life is None or protocol.person.alive == Alive():
        return
    doings = draw_doings(
        streams(protocol, seed, salt), protocol.person.alive, until_s=protocol.phases.time_limit_s,
        wrist_radius_m=simulation.wrist_radius_m(),
    )  # fmt: skip
    simulation.life.wake(simulation.data, doings)


def calibration(protocol: Protocol, seed: int, *, salt: str = "") -> Calibration:
    """The error with which the cell of one trial knows its fixed cameras."""
    return draw_calibration(streams(protocol, seed, salt)["calibration"], protocol)


def sensor_noise(protocol: Protocol, seed: int, *, salt: str = "", noise_salt: str = "") -> SensorNoise:
    """Of one trial; passes everything through where the protocol names no noise. ``noise_salt``: the trial's own,
    without which, and without a ``salt``, the noise reveals the seed."""
    key = streams(protocol, seed, salt)["sensor_noise"].integers(2**32, size=4).tolist()
    if noise_salt:
        # One way: not even the whole noise of a trial gives salt or seed back.
        key = _words(f"{noise_salt} {key}")
    return SensorNoise(protocol.variation, key=key, dt_s=protocol.physics.dt_s)
