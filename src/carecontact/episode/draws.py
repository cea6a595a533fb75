"""The random streams of a trial, and the values that are drawn from them before there is a world."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.protocol import Camera, Protocol

STREAMS = ("comfort_arm", "appearance", "sensor_noise", "policy", "light", "place", "breathing", "repositioning",
           "withdrawal", "calibration", "tissue", "body", "pose", "park", "camera", "bed_height")  # fmt: skip
"""The names of the streams, in the order of the seed's children; a new one has to go to the end."""


def streams(protocol: Protocol, seed: int, salt: str) -> dict[str, np.random.Generator]:
    """Return one generator for each stream. They depend on ``Protocol.drawn_as``, seed and salt only, so that trials
    are paired over tasks, methods and levels.

    Args:
        salt: the trial's secret (``TrialSpec.salt``), without which nobody can tell from a published seed what it
            draws; empty for a run on published seeds.
    """
    if salt:
        # Each stream has a hash of its own: whoever inferred one stream from its draws would know neither the salt nor
        # another stream.
        return {name: np.random.default_rng(words(f"{salt} {protocol.drawn_as} {seed} {name}")) for name in STREAMS}
    children = np.random.SeedSequence([*words(protocol.drawn_as), seed]).spawn(len(STREAMS))
    return {name: np.random.default_rng(child) for name, child in zip(STREAMS, children, strict=True)}


def words(text: str) -> list[int]:
    """Return eight numbers of 32 bits that a text gives for seeding a generator."""
    return np.frombuffer(hashlib.sha256(text.encode()).digest(), "<u4").tolist()


@dataclass(frozen=True, kw_only=True)
class Posture:
    """How a person is laid on the bed."""

    comfort_arm_deg: float
    shoulder_rotation_deg: float
    palm_deg: float
    place: tuple[float, float, float]
    """Place along, across and yaw as shares, from -1 to 1, of the protocol's ranges (``world.place``). On a level with
    wider ranges, the same person therefore lies farther out on the same side."""


def posture_of(protocol: Protocol, seed: int, salt: str, number: int) -> Posture:
    """Return the posture of draw ``number``, from 0, of a seed's person."""
    drawn, variation, person = streams(protocol, seed, salt), protocol.variation, protocol.person
    angles = drawn["comfort_arm"].uniform(*protocol.randomization.comfort_arm_deg, number + 1)
    turns = drawn["pose"].uniform(0.0, 1.0, (number + 1, 2))[number]
    along, across, yaw = drawn["place"].uniform(-1.0, 1.0, (number + 1, 3))[number].tolist()
    rotation, palm = (
        float(low + share * (high - low))
        for share, (low, high) in zip(turns, (variation.shoulder_rotation_deg, variation.palm_deg), strict=True)
    )
    return Posture(
        comfort_arm_deg=float(angles[number]), shoulder_rotation_deg=person.shoulder_rotation_deg + rotation,
        palm_deg=person.palm_deg + palm, place=(along, across, yaw),
    )  # fmt: skip


def body_of(protocol: Protocol, seed: int, salt: str) -> str:
    """Return the body of a seed. Bodies are strata: each block of consecutive seeds has every body once."""
    bodies = protocol.variation.bodies
    if not bodies:
        return protocol.person.body
    block, place = divmod(seed, len(bodies))
    return bodies[streams(protocol, block, salt)["body"].permutation(len(bodies))[place]]


def overhead_of(protocol: Protocol, seed: int, salt: str) -> Camera:
    """Return the overhead camera at its true pose."""
    camera, variation = protocol.cameras["overhead"], protocol.variation
    shift, turn = streams(protocol, seed, salt)["camera"].uniform(-1.0, 1.0, (2, 3))
    if not (variation.overhead_shift_m or variation.overhead_turn_deg):
        return camera
    at, look, up = (np.array(value) for value in (camera.position_m, camera.look_at_m, camera.up))
    ahead = (look - at) / np.linalg.norm(look - at)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    # Columns are the camera's axes in MuJoCo's convention: x right, y up, z back.
    axes = np.stack([right, np.cross(right, ahead), -ahead], 1)
    turned = axes @ _rotation(np.radians(variation.overhead_turn_deg) * turn)
    place = at + variation.overhead_shift_m * shift
    target = place - np.linalg.norm(look - at) * turned[:, 2]
    return camera.model_copy(update={
        "position_m": _vec3(place), "look_at_m": _vec3(target), "up": _vec3(turned[:, 1])
    })  # fmt: skip


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) about the direction of a vector (3,) by its length [rad]."""
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle else np.array([0.0, 0.0, 1.0])
    return matrix_from_quat(np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)]))


def _vec3(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
