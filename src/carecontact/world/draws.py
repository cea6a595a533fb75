"""What a seed draws before there is a simulation: the random streams of a trial, body, posture and place of the person,
the overhead camera, and the person's own movements."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians

import mujoco
import numpy as np

from carecontact.human.foam import Spot
from carecontact.human.pose import RIGHT_SHOULDER_M
from carecontact.human.skeleton import ROOT_JOINT
from carecontact.interface.geometry import matrix_from_quat
from carecontact.protocol.person import Alive, Repositioning
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import FOAM_COLOURS, OTHER_COLOURS, Camera, Rgb, Variation
from carecontact.tissue.life import JOINTS, MOST_MOVES, MotionScript, Move, Pull
from carecontact.world.room import SUPPORT

STREAMS = (
    *"comfort_arm appearance sensor_noise policy light place breathing repositioning withdrawal".split(),
    *"calibration tissue body pose park camera bed_height arm foam distractors".split(),
)
"""The names of the streams, in the order of the seed's children; a new one has to go to the end."""


def streams(protocol: Protocol, seed: int, salt: str) -> dict[str, np.random.Generator]:
    """Return one generator for each stream. They depend on ``Protocol.drawn_as``, seed and salt only, so that trials
    are paired over tasks, methods and levels.

    ``salt``: the trial's secret (``TrialSpec.salt``), without which a published seed does not reveal its draws; empty
    for a run on published seeds.
    """
    if salt:
        # Each stream has its own hash, so that the draws of one stream reveal neither the salt nor another stream.
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
    """Place along, across and yaw as shares, from -1 to 1, of the protocol's ranges (``place_of``). On a level with
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
        comfort_arm_deg=float(angles[number]),
        shoulder_rotation_deg=person.shoulder_rotation_deg + rotation,
        palm_deg=person.palm_deg + palm,
        place=(along, across, yaw),
    )


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
    pose = {"position_m": place, "look_at_m": target, "up": turned[:, 1]}
    return camera.model_copy(update={name: tuple(values.tolist()) for name, values in pose.items()})


def arm_bias_of(protocol: Protocol, seed: int, salt: str) -> np.ndarray:
    """Return the force (3,) at the tool, in base, that the arm of a seed exerts beside what is commanded [N]."""
    errors = protocol.arm_errors
    return np.zeros(3) if errors is None else errors.force_bias_n * streams(protocol, seed, salt)["arm"].normal(size=3)


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) about the direction of a vector (3,) by its length [rad]."""
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle else np.array([0.0, 0.0, 1.0])
    return matrix_from_quat(np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)]))


def spot_of(protocol: Protocol, task_id: str, seed: int, salt: str) -> Spot | None:
    """Return where the seed puts foam for a task, and in which colour; None where the task has none. The tasks on one
    region share the draw, and so do the levels."""
    if protocol.foam is None or not protocol.has_foam(task_id):
        return None
    foam, task = protocol.foam, protocol.task(task_id)
    of_region = np.random.default_rng([*streams(protocol, seed, salt)["foam"].integers(2**32, size=4).tolist(),
                                       *words(task.region)])  # fmt: skip
    along, around = float(of_region.uniform(*foam.along)), float(of_region.uniform(-1.0, 1.0))
    cleaned = task.action == "scrub"
    return Spot(
        along=along,
        around_rad=radians(around * foam.around_deg),
        half_m=foam.oval_m if cleaned else (foam.disc_m, foam.disc_m),
        room_m=foam.room_m,
        colour=FOAM_COLOURS[foam.colours[int(of_region.integers(len(foam.colours)))]],
        on_cells=cleaned,
    )


BESIDE_LEGS_M = ((-0.70, -0.15), (-0.36, -0.30))
"""Where the middle of the towel lies, along the bed and across it, in the world: at its left edge, away from the
robot."""
TOWEL_TURN_DEG = 25.0
DRESSED = ("left_upper_arm", "left_forearm", "left_shank", "right_shank")
"""Limbs that may have a dressing: those that no shipped task names, as far as clothes leave them bare."""
DRESSED_ALONG = (0.35, 0.65)
"""Place of its middle, as a share of the way from one joint to the next."""


@dataclass(frozen=True, kw_only=True)
class Clutter:
    """What the seed draws of the things that are no foam."""

    towel_at_m: tuple[float, float]
    towel_turn_rad: float
    towel_colour: Rgb
    segment: str
    """Limb with the dressing."""
    along: float
    dressing_colour: Rgb


def clutter_of(protocol: Protocol, seed: int, salt: str) -> Clutter | None:
    """Return the same for all tasks and levels of a seed; None where the protocol has no distractors."""
    if protocol.distractors is None:
        return None
    drawn, colours = streams(protocol, seed, salt)["distractors"], protocol.distractors.colours
    x, y = (float(drawn.uniform(*span)) for span in BESIDE_LEGS_M)
    turn, along = radians(drawn.uniform(-TOWEL_TURN_DEG, TOWEL_TURN_DEG)), float(drawn.uniform(*DRESSED_ALONG))
    towel, dressing = (OTHER_COLOURS[colours[int(number)]] for number in drawn.integers(len(colours), size=2))
    return Clutter(
        towel_at_m=(x, y),
        towel_turn_rad=turn,
        towel_colour=towel,
        segment=DRESSED[int(drawn.integers(len(DRESSED)))],
        along=along,
        dressing_colour=dressing,
    )


SHOULDER = np.array([*RIGHT_SHOULDER_M, 0.0])
"""(3,) place on the floor under the right shoulder of a person in the protocol's own place [m]."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Change of the protocol's own place: first a turn about the vertical through the right shoulder, then a shift.

    The turn is about the shoulder because it lies beside the robot: a turn about a farther point would move the arm
    more.
    """

    along_m: float = 0.0
    """Shift along the bed, towards the head."""
    across_m: float = 0.0
    """Shift to the person's right, which is towards the robot."""
    yaw_deg: float = 0.0
    """Turn, counter-clockwise when seen from above."""

    @property
    def shift(self) -> np.ndarray:
        """(3,) shift in the world [m]."""
        return np.array([self.along_m, self.across_m, 0.0])

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Return where points (..., 3) of a person in the protocol's own place are in this place."""
        cos, sin = np.cos(radians(self.yaw_deg)), np.sin(radians(self.yaw_deg))
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return SHOULDER + self.shift + (points - SHOULDER) @ turn.T


UNMOVED = Place()


def place_of(shares: Sequence[float], variation: Variation) -> Place:
    """Return the place for three shares of the ranges, from -1 to 1: along, across and yaw."""
    along, across, yaw = shares
    up = variation.place_toward_head_m
    farthest = variation.place_along_m if up is None or along < 0 else min(up, variation.place_along_m)
    return Place(
        along_m=along * farthest, across_m=across * variation.place_across_m, yaw_deg=yaw * variation.place_yaw_deg
    )


def move_person(model: mujoco.MjModel, place: Place) -> None:
    """Move the person, the pillow and the arm board in a compiled model; bed, robot and cameras stay where they are.

    Call it once, before the person settles: it changes where a reset puts the person.
    """
    turn, at, shift = np.zeros(4), SHOULDER, place.shift
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), radians(place.yaw_deg))

    def moved(position: np.ndarray, quat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset, turned = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(offset, np.asarray(position, np.float64) - at, turn)
        mujoco.mju_mulQuat(turned, turn, np.asarray(quat, np.float64))
        return at + offset + shift, turned

    support = model.body(SUPPORT)
    support.pos[:], support.quat[:] = moved(support.pos, support.quat)
    start = model.joint(ROOT_JOINT).qposadr[0]
    root = model.qpos0[start : start + 7]
    root[:3], root[3:] = moved(root[:3].copy(), root[3:].copy())


def place_in_model(model: mujoco.MjModel) -> list[float]:
    """Return 14 numbers: the pose of the person at a reset, and that of pillow and board. ``move_person`` changes these
    and nothing else in a compiled model.
    """
    start, support = model.joint(ROOT_JOINT).qposadr[0], model.body(SUPPORT)
    return [*model.qpos0[start : start + 7].tolist(), *support.pos.tolist(), *support.quat.tolist()]


TONE = {"passive": 0.0, "helps": 0.0, "holds": 0.15}
"""Manner -> activation of the muscles at rest (assumed): the shoulder of a person who holds is about twenty times as
stiff as a passive one."""
HELP = {"passive": 0.0, "helps": 0.8, "holds": 0.0}
"""Manner -> share of the passive joints' stiffness and damping that the person cancels by helping (assumed)."""
LIFT_RAD = 0.13
"""Commanded flexion of the shoulder in the middle of a change of posture: man-adult's wrist then rises by about 10 mm
and does not rub on the board."""
WIDEST_M = 0.08
"""Largest distance of the wrist, along the board, from where it lay at first."""
REST_S = 0.5
"""Least time from the end of a change of posture to the next one."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """A change of posture, drawn before it is known how the person lies."""

    time_s: float
    duration_s: float
    wrist_m: float
    """Displacement of the wrist along the board; away from the trunk is positive."""


def draw_shifts(rng: np.random.Generator, wanted: Repositioning, *, until_s: float) -> list[Shift]:
    """Draw changes of posture, with exponentially distributed pauses between them, whose onsets are before ``until_s``.

    They are drawn before the trial and therefore cannot depend on the robot. The first onset may come at once.
    """
    out: list[Shift] = []
    now = at = 0.0
    gap_s = max(0.0, 60.0 / wanted.per_minute - np.mean(wanted.duration_s) - REST_S)
    while len(out) < MOST_MOVES:
        now += float(rng.exponential(gap_s))
        size, duration = float(rng.uniform(*wanted.wrist_m)), float(rng.uniform(*wanted.duration_s))
        way = float(rng.choice([-1.0, 1.0]))
        if now >= until_s:
            break
        if abs(at + way * size) > WIDEST_M:
            way = -np.sign(at)
        out.append(Shift(time_s=now, duration_s=duration, wrist_m=way * size))
        at += way * size
        now += duration + REST_S
    return out


def draw_motion_script(
    rng: dict[str, np.random.Generator], alive: Alive, *, until_s: float, wrist_radius_m: float
) -> MotionScript:
    """Draw all movements of one person.

    Args:
        rng: streams ``breathing``, ``repositioning`` and ``withdrawal``.
        until_s: length of the longest trial [s].
        wrist_radius_m: horizontal distance of the wrist from the shoulder [m].
    """
    abduction = np.array([joint.endswith("abduction") for joint in JOINTS], np.float64)
    out = MotionScript(tone=TONE[alive.manner], help=HELP[alive.manner])
    if (b := alive.breathing) is not None:
        draw = rng["breathing"].uniform
        hz, belly, chest = (float(draw(*pair)) for pair in (b.frequency_hz, b.abdomen_m, b.chest_m))
        out = replace(
            out, breath_hz=hz, inspiration_share=b.inspiration_share, phase=float(draw()), breath_m=(belly, chest)
        )
    if alive.repositioning is not None:
        shifts = draw_shifts(rng["repositioning"], alive.repositioning, until_s=until_s)
        moves = [
            Move(
                time_s=shift.time_s,
                duration_s=shift.duration_s,
                lift_rad=LIFT_RAD,
                shift_rad=shift.wrist_m / wrist_radius_m * abduction,
            )
            for shift in shifts
        ]
        out = replace(out, moves=tuple(moves))
    if (w := alive.withdrawal) is not None:
        force_n, shift_rad = float(rng["withdrawal"].uniform(*w.force_n)), -w.wrist_m / wrist_radius_m * abduction
        pull = Pull(force_n=force_n, for_s=w.for_s, delay_s=w.delay_s, duration_s=w.duration_s, shift_rad=shift_rad)
        out = replace(out, pull=pull)
    return out
