"""The paper's first method: it perceives once, chooses contact primitives among candidates by language, and executes
them open loop."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.body_view import RegionGeometry, person_points, region_from_observation
from carecontact.interface.geometry import matrix_from_quat, pixels
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import ActionBounds, Session
from carecontact.policies.foam import FoamSeen, find_foam, holds, names_foam, strokes
from carecontact.policies.language.backend import Intent, LanguageBackend, LanguageModel, Option, Rules
from carecontact.policies.language.live import transcript_of
from carecontact.policies.motion import (
    CAP_RADIUS_M,
    CONTROL_HZ,
    FREE_SPEED_M_S,
    NEAR_SPEED_M_S,
    TRAVEL_CLEARANCE_M,
    UP,
    Leg,
    chunk,
    radial_quat,
    tool_quat,
    travel,
)

# Every depth, speed and distance of the state machine, with its reason; all were fixed before the first scored run.
#
# Speeds of free motion are in ``policies.motion``. With the default translational stiffness K = 400 N/m, a point that
# is commanded at a depth d below the surface presses with K (d - deflection of the tissue): 12 mm can give at most 4.8
# N, and 60 mm at most 24 N.

NEAR_M = 0.030
"""Closer to the skin than this, the tool moves at the slower speed."""
HOVER_M = 0.060
"""Height above the skin at which slow motion begins: twice NEAR_M, because a seen surface is uncertain by 10 mm."""

TRAVEL_CORRIDOR_M = 0.15
"""Half width of the strip under the way in which the person's highest point is looked for."""

DESCENT_SPEED_M_S = 0.04
"""Speed of the way down before strokes and pushes."""

TOUCH_DEPTHS_M = (0.012, 0.018)
"""Three times the 4 mm error of a surface seen from overhead, or more; at most 4.8 and 7.2 N."""
TOUCH_SPEEDS_M_S = (0.03, 0.05)
TOUCH_DWELL_S = 2.0
"""A slow, clear rest: four times the shortest contact that a person would call a touch, after the arm has caught up
(0.3 s)."""
TOUCH_KEY_POINTS = (0.35, 0.5, 0.65)

SCRUB_DEPTHS_M = (0.015, 0.022)
"""Deeper than a touch, so that a surface that curves away from its profile by 5 mm stays in contact."""
SCRUB_SPEEDS_M_S = (0.07, 0.10)
"""The pace of washing by hand, within the speed limit near the skin."""
SCRUB_HALF_STROKE_M = 0.060
SCRUB_PASSES = 3
"""Passes from end to end, after half a pass from the middle, where the tool comes down: three turns."""
SCRUB_END_DWELL_S = 0.35
"""One time constant of the impedance: the tool reaches the end of the stroke before it turns."""
SCRUB_END_MARGIN_M = 0.010
SCRUB_STEP_M = 0.010
SCRUB_KEY_POINTS = (0.45, 0.5, 0.55)

PUSH_OVERTRAVEL_M = (0.060, 0.075)
"""How far past the limb's visible side the tool is commanded: 20 mm for the limb to move and the rest for the spring to
press. At most 24 and 30 N even if the limb did not move at all."""
PUSH_SPEEDS_M_S = (0.05, 0.08)
PUSH_HOLD_S = 2.0
PUSH_KEY_POINTS = (0.55, 0.7)
"""Middle and distal forearm: a longer lever about the elbow."""
PUSH_STANDOFF_M = 0.025
"""Gap between tool and limb where the tool comes down: twice the lateral error of a seen limb."""
PUSH_SUPPORT_CLEARANCE_M = 0.018
"""Height of the tool's tip over the arm board."""
PUSH_TILT_RAD = 0.35
"""The hand leans back by 20 degrees, so that it does not overhang the limb that it pushes."""
PUSH_BACK_OFF_M = 0.040

SHOULDER_HEIGHT_M = 0.333
"""Height of the Panda's joint 2 over its base (data sheet)."""
FLANGE_TO_TCP_M = 0.107 + 0.117
"""Along the axis of joint 7, from level with joint 6 to the flange (0.107 m, data sheet) and on to the tool centre
point (0.117 m, this tool)."""
WRIST_OFFSET_M = 0.088
"""Distance of joint 6 from the axis of joint 7 (data sheet)."""
SHOULDER_TO_WRIST_M = (0.26, 0.712)
"""The distance when joint 4 is at about -2.9 and -0.75 rad: 0.2 rad from its folded limit, and 0.3 rad from elbow and
wrist in one line."""


F64 = npt.NDArray[np.float64]


def touch(geometry: RegionGeometry, *, key_point: float, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Move down onto the skin at ``speed_m_s``, rest there, and move up.

    Args:
        key_point: place along the region, 0 at its proximal end (abdomen: caudal) and 1 at the other end.
        depth_m: how far below the seen skin the tool is commanded [m].
    """
    skin = geometry.surface((key_point - 0.5) * 2 * geometry.half_length_m)
    return touch_at(skin, radial_quat(geometry.centre_m), UP, depth_m, speed_m_s)


def touch_at(skin: F64, quat: F64, out: F64, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Like ``touch``, at a place (3,) of the skin, with the tool held as ``quat`` (4,) and moved along ``out`` (3,)."""
    over = skin + HOVER_M * out
    return [
        Leg.to(over, quat, FREE_SPEED_M_S),
        Leg.to(skin - depth_m * out, quat, speed_m_s, hold_s=TOUCH_DWELL_S),
        Leg.to(over, quat, NEAR_SPEED_M_S),
    ]


def scrub(geometry: RegionGeometry, *, key_point: float, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Move down, to one end of the stroke, back and forth along the region's axis over the seen surface, and up.

    The arguments are those of ``touch``. The middle of the stroke is moved inward where the stroke would not fit.
    """
    half, hold = min(SCRUB_HALF_STROKE_M, geometry.half_length_m - SCRUB_END_MARGIN_M), SCRUB_END_DWELL_S
    room = geometry.half_length_m - SCRUB_END_MARGIN_M - half
    middle = float(np.clip((key_point - 0.5) * 2 * geometry.half_length_m, -room, room))
    steps = int(np.ceil(half / SCRUB_STEP_M))
    along = np.linspace(middle - half, middle + half, 2 * steps + 1)
    stroke = np.array([geometry.surface(s) - depth_m * UP for s in along])
    quat = radial_quat(geometry.centre_m)
    skin = stroke[steps] + depth_m * UP
    passes = [stroke[steps + 1 :], *([stroke[-2::-1], stroke[1:]] * SCRUB_PASSES)[:SCRUB_PASSES]]
    return [
        Leg.to(skin + HOVER_M * UP, quat, FREE_SPEED_M_S),
        Leg.to(stroke[steps], quat, DESCENT_SPEED_M_S, hold_s=hold),
        *(Leg(points=path, quat_wxyz=quat, speed_m_s=speed_m_s, hold_s=hold) for path in passes),
        Leg.to(passes[-1][-1] + depth_m * UP + HOVER_M * UP, quat, NEAR_SPEED_M_S),
    ]


def wipe(foam: FoamSeen, quat: F64, out: F64, depth_m: float, speed_m_s: float) -> list[Leg]:
    """Move down at one end of the foam, to and fro along it in lanes side by side, and up, held as in ``touch_at``."""
    ways = [way - depth_m * out for lane in strokes(foam) for way in lane]
    first, last, hold = ways[0][0], ways[-1][-1], SCRUB_END_DWELL_S
    return [
        Leg.to(first + (depth_m + HOVER_M) * out, quat, FREE_SPEED_M_S),
        Leg.to(first, quat, DESCENT_SPEED_M_S, hold_s=hold),
        *(Leg(points=way, quat_wxyz=quat, speed_m_s=speed_m_s, hold_s=hold) for way in ways),
        Leg.to(last + (depth_m + HOVER_M) * out, quat, NEAR_SPEED_M_S),
    ]


def push(
    geometry: RegionGeometry,
    *,
    key_point: float,
    depth_m: float,
    speed_m_s: float,
    support_height_m: float,
    towards_base: bool,
) -> list[Leg]:
    """Move down beside the limb, sideways against it and beyond, hold, back away, and up.

    The push is level and across the limb's axis: pressing a limb into what it lies on moves nothing.

    Args:
        key_point: place along the limb, as for ``touch``.
        depth_m: how far past the limb's visible side the tool is commanded [m].
        support_height_m: height in base of what the limb lies on [m].
        towards_base: whether the tool comes from the side that faces the robot's base.
    """
    skin = geometry.surface((key_point - 0.5) * 2 * geometry.half_length_m)
    side = np.sign(-skin @ geometry.lateral) or 1.0
    outward = geometry.lateral * (side if towards_base else -side)
    tip = support_height_m + max(PUSH_SUPPORT_CLEARANCE_M, 0.5 * (skin[2] - support_height_m) - CAP_RADIUS_M)
    beside = skin + (geometry.radius_m + CAP_RADIUS_M + PUSH_STANDOFF_M) * outward
    low = np.array([beside[0], beside[1], tip])
    pushed = low - (PUSH_STANDOFF_M + depth_m) * outward
    tool_axis = -np.cos(PUSH_TILT_RAD) * UP - np.sin(PUSH_TILT_RAD) * outward
    # Of the two ways round, the one that turns the wrist less from its middle.
    reach = np.array([skin[0], skin[1], 0.0])
    quat = tool_quat(tool_axis, outward if outward @ reach > 0 else -outward)
    away = low + PUSH_BACK_OFF_M * outward
    away_high = away + (skin[2] + HOVER_M - tip) * UP
    return [
        Leg.to(beside + HOVER_M * UP, quat, FREE_SPEED_M_S),
        Leg.to(low, quat, DESCENT_SPEED_M_S),
        Leg.to(pushed, quat, speed_m_s, hold_s=PUSH_HOLD_S),
        Leg.to(away, quat, NEAR_SPEED_M_S),
        Leg.to(away_high, quat, NEAR_SPEED_M_S),
    ]


def travel_height(person: F64, start_pose: F64, goal: F64) -> float:
    """Return a height in base [m] that clears a person (N, 3) between the parked tool (7,) and ``goal`` (3,)."""
    start = start_pose[:2]
    way = goal[:2] - start
    offset = person[:, :2] - start
    share = np.clip(offset @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
    near = np.linalg.norm(offset - share[:, None] * way, axis=1) < TRAVEL_CORRIDOR_M
    top = float(person[near, 2].max()) if near.any() else float(goal[2])
    return top + TRAVEL_CLEARANCE_M


class PlanningFailure(ContractError):
    """The state machine has no motion that stays within the arm's reach and the workspace."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An option together with the motion that carries it out."""

    option: Option
    legs: list[Leg]
    """The whole way, from the pose in which the arm is parked until the arm is up again."""

    @property
    def corners_m(self) -> F64:
        """(n, 3) places in base [m] where the tool comes down and where each motion in contact ends."""
        return np.array([leg.points[-1] for leg in self.legs[3:-2]])


def candidates(
    geometry: RegionGeometry,
    *,
    start_pose: F64,
    travel_height_m: float,
    bounds: ActionBounds | None,
    foam: FoamSeen | None = None,
    person: F64 | None = None,
) -> list[Candidate]:
    """Return all options that the arm reaches in comfort and whose way stays inside the workspace, in a fixed order.

    Raises PlanningFailure if there is none.

    Args:
        start_pose: (7,) pose of the parked tool in base, position [m] and quat_wxyz.
        travel_height_m: height in base at which the tool moves level over the person [m].
        bounds: the session's limits; None leaves the workspace unlimited.
        foam: what touches and scrubs go to, in place of the region's key points.
        person: (N, 3) seen points of the person in base [m], of whom the hand keeps clear at the foam.
    """
    found = [
        Candidate(option=option, legs=legs)
        for option, contact in (_options(geometry) if foam is None else _foam_options(geometry, foam, person))
        if reachable(contact) and _inside(legs := travel(start_pose, contact, travel_height_m=travel_height_m), bounds)
    ]
    if not found:
        place = np.round(geometry.centre_m, 3).tolist()
        raise PlanningFailure(
            f"the arm cannot reach the {geometry.region.replace('_', ' ')} at {place} m in base without leaving its "
            "comfortable range or the workspace"
        )
    return found


def _options(geometry: RegionGeometry) -> Iterator[tuple[Option, list[Leg]]]:
    for motion in _motions(TOUCH_KEY_POINTS, TOUCH_DEPTHS_M, TOUCH_SPEEDS_M_S):
        yield Option(primitive="touch", approach="above", **motion), touch(geometry, **motion)
    for motion in _motions(SCRUB_KEY_POINTS, SCRUB_DEPTHS_M, SCRUB_SPEEDS_M_S):
        yield Option(primitive="scrub", approach="above", **motion), scrub(geometry, **motion)
    support = geometry.support_height_m
    if not REGIONS[geometry.region].sided or support is None:  # the trunk is not pushed aside
        return
    for side in ("near_side", "far_side"):
        for motion in _motions(PUSH_KEY_POINTS, PUSH_OVERTRAVEL_M, PUSH_SPEEDS_M_S):
            legs = push(geometry, **motion, support_height_m=support, towards_base=side == "near_side")
            yield Option(primitive="push", approach=side, **motion), legs


def _motions(*values: Iterable[float]) -> list[dict[str, float]]:
    return [dict(zip(("key_point", "depth_m", "speed_m_s"), each, strict=True)) for each in product(*values)]


def _foam_options(geometry: RegionGeometry, foam: FoamSeen, person: F64 | None) -> Iterator[tuple[Option, list[Leg]]]:
    """Strokes are many: they are made at the slower speed alone. The first hold that the arm reaches is taken."""
    along = float((foam.centre_m - geometry.centre_m) @ geometry.axis) / (2 * geometry.half_length_m)
    key = round(float(np.clip(0.5 + along, 0.0, 1.0)), 2)
    ways = holds(foam, np.zeros((0, 3)) if person is None else person)
    for motion in _motions([key], TOUCH_DEPTHS_M, TOUCH_SPEEDS_M_S):
        contacts = (touch_at(foam.centre_on_skin, *way, motion["depth_m"], motion["speed_m_s"]) for way in ways)
        yield Option(primitive="touch", approach="above", **motion), _first_reached(contacts)
    for motion in _motions([key], SCRUB_DEPTHS_M, SCRUB_SPEEDS_M_S[:1]):
        contacts = (wipe(foam, *way, motion["depth_m"], motion["speed_m_s"]) for way in ways)
        yield Option(primitive="scrub", approach="above", **motion), _first_reached(contacts)


def _first_reached(contacts: Iterable[list[Leg]]) -> list[Leg]:
    """Return the first contact that the arm reaches, or the last one."""
    contact = list[Leg]()
    for contact in contacts:
        if reachable(contact):
            break
    return contact


def reachable(contact: list[Leg]) -> bool:
    """Whether the elbow is neither folded nor straight at any point of ``contact``, by SHOULDER_TO_WRIST_M."""
    nearest, farthest = SHOULDER_TO_WRIST_M
    shoulder = np.array([0.0, 0.0, SHOULDER_HEIGHT_M])
    for leg in contact:
        tool_axis = matrix_from_quat(leg.quat_wxyz)[:, 2]
        outward = leg.points * [1.0, 1.0, 0.0]
        outward -= (outward @ tool_axis)[:, None] * tool_axis
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        wrist = leg.points - FLANGE_TO_TCP_M * tool_axis - WRIST_OFFSET_M * outward
        distance = np.linalg.norm(wrist - shoulder, axis=1)
        if distance.min() < nearest or distance.max() > farthest:
            return False
    return True


def _inside(legs: list[Leg], bounds: ActionBounds | None) -> bool:
    if bounds is None:
        return True
    # Straight lines between points of a box stay in the box, so that the points suffice.
    low, high = np.array(bounds.workspace_low_m), np.array(bounds.workspace_high_m)
    return all(bool(((leg.points >= low) & (leg.points <= high)).all()) for leg in legs)


CAMERA = "overhead"
logger = logging.getLogger(__name__)


class StateMachine:
    """Looks once with the robot parked, lets a language backend choose a motion, and executes it without looking again.

    If the region cannot be found or reached, it ends the trial without touching and logs the reason.
    """

    def __init__(self, *, language: str | LanguageBackend = Rules.name, record: Path | None = None) -> None:
        """``language``: rules-v1, replay:FILE.jsonl, live:MODEL, or the backend itself; ``record``: file to which the
        completions of a live model are added.

        Raises ConfigError for a language that cannot be read, DependencyError for live without its package.
        """
        if isinstance(language, str):
            transcript = transcript_of(language, record=record)
            language = Rules() if transcript is None else LanguageModel(transcript)
        self._language = language
        self.card = PolicyCard(
            name="state-machine",
            modalities=("rgb", "depth", "points", "masks", "landmarks"),
            cameras=(CAMERA,),
            control_hz=CONTROL_HZ,
            language_backend=self._language.name,
        )
        self._bounds: ActionBounds | None = None
        self._intent: Intent | None = None
        self._to_foam = False
        self._notes: dict[str, object] = {}

    def configure(self, session: Session) -> None:
        self._bounds = session.action_bounds

    def reset(self, instruction: str) -> None:
        """Read the instruction. Raises LanguageError if the backend does not understand it."""
        self._intent, self._notes = None, {}
        self._intent = self._language.parse(instruction)
        self._to_foam = self._intent.action != "push" and names_foam(instruction)

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the whole plan as one chunk of at most MAX_CHUNK actions, of which the last one ends the trial."""
        try:
            actions = chunk(self.choose(observation).legs, observation.pose_tcp_in_base)
            if len(actions) > MAX_CHUNK:
                raise PlanningFailure(f"the plan has {len(actions)} actions; a chunk holds at most {MAX_CHUNK}")
        except ContractError as error:
            logger.warning("The state machine ends the trial without touching: %s", error)
            self._notes["ended_without_touching"] = str(error)
            return [Action(done=True)]
        return actions

    def choose(self, observation: Observation) -> Candidate:
        """Return the motion that the language backend chooses for what is seen.

        Raises PerceptionFailure if the region is not found, and PlanningFailure if the arm reaches no place of it.
        """
        intent, view, start = self._intent, observation.cameras[CAMERA], observation.pose_tcp_in_base
        if intent is None:
            raise ContractError("act() was called before reset()")
        side = "right" if intent.side == "none" else intent.side
        geometry = region_from_observation(observation, intent.region, side=side, camera=CAMERA)
        person, foam = person_points(view), find_foam(view, geometry) if self._to_foam else None
        height = travel_height(person, start, geometry.centre_m)
        options = candidates(
            geometry, start_pose=start, travel_height_m=height, bounds=self._bounds, foam=foam, person=person
        )
        self._notes |= {"method": self.card.name, "camera": CAMERA, "intent": intent.model_dump()}
        if foam is not None:
            self._notes["foam_m"] = foam.centre_m.round(4).tolist()
        noted = self._notes["options"] = list[dict[str, object]]()
        for candidate in options:
            corners = candidate.corners_m
            seen = pixels(corners, view.intrinsics, view.pose_camera_in_base)
            places = {"corners_m": corners.round(4).tolist(), "corners_px": seen.round(1).tolist()}
            noted.append(asdict(candidate.option) | places)
        index = self._notes["chosen"] = self._language.choose(intent, [option.option for option in options])
        logger.info("The state machine chose %s of %d options", options[index].option, len(options))
        return options[index]

    def take_notes(self) -> dict[str, object]:
        """Return the options with their places in the picture, the choice, and the calls to a language model."""
        calls, notes = self._language.take_calls(), self._notes
        self._notes = {}
        return notes | ({"language": calls} if calls else {})
