"""How a person lies: spheres on which the body rests, the angle of each hinge before it settles, and where the trunk
obstructs a hand over the arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from carecontact.human.body import CHILD_ALONG, PARENT, Array, Body
from carecontact.human.joints import Hinge, hinges

MOST_TILT_DEG = 1.5
"""Largest tilt [deg] of the trunk: the mattress gives way under the pelvis, which carries the most weight, until the
trunk lies about level (assumed)."""


@dataclass(frozen=True, kw_only=True)
class Proxy:
    """A sphere that meets only the bed, the pillow and the arm board."""

    name: str
    segment: str
    centre: Array
    """(3,) mesh frame, bind pose"""
    radius_m: float


def bed_proxies(body: Body) -> list[Proxy]:
    """Return the spheres on which a body lies, some of which touch the rearmost point of its surface from inside."""
    rows: list[Proxy] = []

    def add(segment: str, name: str, centre: Array, radius: float) -> None:
        rows.append(Proxy(name=name, segment=segment, centre=centre, radius_m=radius))

    def under(segment: str, name: str, surface: Array, radius: float, *, sunk_m: float = 0.0) -> None:
        add(segment, name, surface - np.array([0, radius + sunk_m, 0]), radius)

    j, sunk = body.joint_centre, pelvis_immersion(body)
    for side in ("left", "right"):
        buttock, scapula = _trunk_supports(body, side)
        under("pelvis", f"{side}_buttock", buttock, BUTTOCK_RADIUS_M, sunk_m=sunk)
        under("thorax", f"{side}_scapula", scapula, SCAPULA_RADIUS_M)
        calf = j[f"{side}_shank"] + 0.35 * body.axis_vector(f"{side}_shank")
        under(f"{side}_shank", f"{side}_calf", _back_of(body.vertices_of(f"{side}_shank"), calf), 0.04)
        foot = body.vertices_of(f"{side}_foot")
        under(f"{side}_foot", f"{side}_heel", foot[foot[:, 1].argmax()], 0.025)
        # Limbs turn about their own axis, so that a sphere centred on it meets the bed in the same way at every turn.
        # A percentile of the section's radii serves as radius, so that the skin does not sink into the board.
        limbs = ("upper_arm", 0.95, "elbow", 60), ("forearm", 0.92, "wrist", 85), ("hand", 0.55, "hand", 60)
        for segment, along, name, inside in limbs:
            full = f"{side}_{segment}"
            points = body.vertices_of(full, *([f"{side}_forearm"] if segment == "upper_arm" else []))
            axis, unit = body.axis_vector(full), body.direction(full)
            centre = j[full] + along * axis
            near = points[np.abs((points - centre) @ unit) < 0.02]
            off = near - centre
            centre = centre + (off.mean(0) - (off.mean(0) @ unit) * unit)
            off = near - centre
            radius = float(np.percentile(np.linalg.norm(off - np.outer(off @ unit, unit), axis=1), inside))
            add(full, f"{side}_{name}", centre, radius)
    head = body.vertices_of("head")
    under("head", "occiput", head[head[:, 1].argmax()] * [0.0, 1.0, 1.0], 0.07)
    return rows


BUTTOCK_RADIUS_M, SCAPULA_RADIUS_M = 0.07, 0.06


def pelvis_immersion(body: Body) -> float:
    """Return how much deeper the buttocks sink into the mattress than the shoulder blades [m]."""
    buttock, scapula = _trunk_supports(body, "right")
    apart = scapula[2] - buttock[2]
    return max(0.0, float(buttock[1] - scapula[1] - apart * np.sin(np.radians(MOST_TILT_DEG))))


def trunk_tilt(body: Body) -> float:
    """Return the angle [rad] by which the head end of a trunk that lies on its four supports is lowered."""
    low, high = (p for p in bed_proxies(body) if p.name in ("right_buttock", "right_scapula"))
    along, depth = high.centre[2] - low.centre[2], low.centre[1] - high.centre[1]
    # The angle of the common tangent of two circles, from the line of their centres and the difference of their radii.
    return float(np.arctan2(depth, along) + np.arcsin((low.radius_m - high.radius_m) / np.hypot(along, depth)))


def _trunk_supports(body: Body, side: str) -> tuple[Array, Array]:
    """Return the rearmost points (3,) of the buttock and of the shoulder blade."""
    sign = 1.0 if side == "left" else -1.0
    j = body.joint_centre
    trunk = body.vertices_of("pelvis", "abdomen", "thorax", "left_thigh", "right_thigh")
    buttock = _back_of(trunk, np.array([sign * 0.08, 0, j[f"{side}_thigh"][2] - 0.01]))
    return buttock, _back_of(trunk, np.array([sign * 0.09, 0, j[f"{side}_upper_arm"][2] - 0.06]))


def _back_of(points: Array, near: Array) -> Array:
    """Return the rearmost surface point near a point, by distance across the body's front-back axis."""
    distance = np.hypot(points[:, 0] - near[0], points[:, 2] - near[2])
    close = points[distance < 0.04] if (distance < 0.04).any() else points[[distance.argmin()]]
    return np.array([near[0], close[:, 1].max(), near[2]])


BOARD_HEIGHT_M = 0.022
"""Height of the padded arm board above the mattress: it bends the elbow a little, so that every joint of the arm rests
inside its range."""
MIDDLE_ARM_DEG = 52.5
"""Middle of the comfort arm's range, 45 to 60 degrees."""
RIGHT_SHOULDER_M = (0.438, 0.195)
"""World x and y of the right shoulder's centre, the same for every body, so that the comfort arm begins beside its
board."""

# Columns are the mesh frame's axes in the world: mesh z (head) -> +x, mesh -y (front) -> +z, mesh x (left) -> -y.
SUPINE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


FIXED_SEGMENTS = frozenset(
    ["abdomen", "thorax", *(f"{s}_{n}" for s in ("left", "right") for n in ("clavicle", "thigh", "shank", "foot"))]
)
"""Segments that are welded in the lying pose: no task moves them, and their hinges cost time in every step. Trunk and
legs still lie on the bed by contact, so that the bed carries the person's weight and every press."""
LIES_DEG = {
    "right_upper_arm_rotation": 0.0,
    "right_forearm_supination": 58.0,
    "right_hand_flexion": 0.0,
    "left_upper_arm_abduction": 22.0,
    "left_upper_arm_rotation": 10.0,
    "left_forearm_supination": 45.0,
    **{f"{s}_thigh_abduction": 3.0 for s in ("left", "right")},
    **{f"{s}_foot_plantarflexion": 18.0 for s in ("left", "right")},
}
"""Angles [deg] that are the same for every body; the right arm lies palm up on its board. Other hinges keep the bind
pose, except the flexion of shoulder, elbow and hip, which follows from the body's own thickness."""


PALM_PER_ROTATION = 0.9
"""Turn of the forearm, for each degree of the upper arm's rotation, that keeps the palm up. It is not 1 because the
elbow is a little bent."""
PALM_DEG = (-60.0, 66.0)
"""Least and largest turn of the forearm in a lying pose, at least 4 degrees inside the joint's range."""


@dataclass(frozen=True, kw_only=True)
class ArmTurn:
    """How the right arm is turned, besides its abduction: ``Person.shoulder_rotation_deg`` and ``Person.palm_deg``."""

    shoulder_rotation_deg: float = 0.0
    palm_deg: float = 0.0

    def angles(self) -> dict[str, float]:
        """Return hinge -> angle [deg], which replace those of LIES_DEG."""
        if not (self.shoulder_rotation_deg or self.palm_deg):
            return {}
        rotation, palm = "right_upper_arm_rotation", "right_forearm_supination"
        turned = LIES_DEG[palm] + (PALM_PER_ROTATION * self.shoulder_rotation_deg + self.palm_deg)
        shoulder = LIES_DEG[rotation] + self.shoulder_rotation_deg
        return {rotation: shoulder, palm: float(np.clip(turned, *PALM_DEG))}


NOT_TURNED = ArmTurn()

LEAST_ELBOW_DEG = 7.0
"""Least distance [deg] of the elbow from the end of its range."""


def lying_pose_deg(body: Body, comfort_arm_deg: float, turn: ArmTurn = NOT_TURNED) -> dict[str, float]:
    """Return hinge -> anatomical angle [deg]; hinges that are not named keep the bind pose.

    The trunk rests on buttocks and shoulder blades. Then shoulder, elbow and hip are flexed until elbow, wrist and heel
    (or calf) just touch what is under them: the board under the right arm, elsewhere the mattress.
    """
    rows, at = hinges(body), {proxy.name: proxy for proxy in bed_proxies(body)}
    laid = {**LIES_DEG, **turn.angles()}
    pose = {**laid, "right_upper_arm_abduction": comfort_arm_deg}
    trunk = trunk_rotation(body)
    mattress = _height(body, rows, pose, trunk, at["right_buttock"])

    def flex(hinge: str, touching: tuple[str, ...], above_m: float, low: float, high: float) -> None:
        """Set one hinge so that the lowest of some spheres lies ``above_m`` over the mattress."""

        def gap(angle: float) -> float:
            pose[hinge] = angle
            return min(_height(body, rows, pose, trunk, at[name]) for name in touching) - mattress - above_m

        pose[hinge] = angle_of_root(gap, low, high)

    for side, board in (("left", 0.0), ("right", BOARD_HEIGHT_M)):
        shoulder, elbow = f"{side}_upper_arm_flexion", f"{side}_forearm_flexion"
        flex(shoulder, (f"{side}_elbow",), board, -45.0, 30.0)
        flex(elbow, (f"{side}_wrist",), board, 0.0, 60.0)
        least = next(row.range_deg[0] for row in rows if row.name == elbow) + LEAST_ELBOW_DEG
        if pose[elbow] < least:
            # A slim arm would lie straight. Turning it outward bends the elbow along the board instead.
            pose[elbow] = least
            turned, palm = f"{side}_upper_arm_rotation", f"{side}_forearm_supination"
            for _ in range(4):  # turning lifts the elbow a little
                flex(turned, (f"{side}_wrist",), board, -80.0, laid[turned])
                flex(shoulder, (f"{side}_elbow",), board, -45.0, 30.0)
            pose[palm] = laid[palm] + pose[turned] - laid[turned]
        flex(f"{side}_thigh_flexion", (f"{side}_heel", f"{side}_calf"), 0.0, -14.0, 30.0)
    return pose


def rest_deg(rows: Sequence[Hinge], pose_deg: dict[str, float]) -> list[float]:
    """Return the angle [deg] of each hinge at which its spring has no torque, for a person who is laid in a pose.

    An elbow rests at its neutral angle unless its arm was turned outward (``lying_pose_deg``). There, this torque would
    pull the forearm along the board to the end of the shoulder's rotation, so that the elbow rests where it was laid.
    """
    rest: list[float] = []
    for row in rows:
        turned = f"{row.name.partition('_')[0]}_upper_arm_rotation"
        free = pose_deg.get(turned, 0.0) == LIES_DEG.get(turned, 0.0)
        laid = pose_deg.get(row.name, row.bind_deg)
        rest.append(row.neutral_deg if free and row.neutral_deg is not None else laid)
    return rest


def angle_of_root(gap: Callable[[float], float], low: float, high: float) -> float:
    """Return where a rising function crosses zero; if it does not, the nearer end of the range.

    It uses 24 bisections and not scipy's root finding, because the lying pose is part of every settled world, and its
    last bits decide whether old trials can be repeated.
    """
    for _ in range(24):
        middle = (low + high) / 2
        low, high = (middle, high) if gap(middle) < 0 else (low, middle)
    return (low + high) / 2


def trunk_rotation(body: Body) -> Array:
    """Return the rotation (3, 3) from the mesh frame to the world of a supine trunk on its supports."""
    return axis_rotation(np.array([0.0, 1.0, 0.0]), trunk_tilt(body)) @ SUPINE


def root_position(body: Body, mattress_top_m: float) -> Array:
    """Return the place (3,) [m] of the pelvis in the world for which the right shoulder is at its place beside the
    board and the buttocks lie on the mattress.
    """
    trunk, pelvis = trunk_rotation(body), body.joint_centre["pelvis"]
    buttock = next(proxy for proxy in bed_proxies(body) if proxy.name == "right_buttock")
    shoulder = trunk @ (body.joint_centre["right_upper_arm"] - pelvis)
    height = mattress_top_m - _height(body, [], {}, trunk, buttock)
    return np.array([RIGHT_SHOULDER_M[0] - shoulder[0], RIGHT_SHOULDER_M[1] - shoulder[1], height])


def segment_pose(
    body: Body, rows: list[Hinge], pose_deg: dict[str, float], trunk: Array, segment: str
) -> tuple[Array, Array]:
    """Return a segment's rotation (3, 3) from the mesh frame to the world, and the vector (3,) [m] from the pelvis'
    joint to its own. ``trunk``: the pelvis' rotation (3, 3).
    """
    chain = [segment]
    while (parent := PARENT[chain[0]]) is not None:
        chain.insert(0, parent)
    turn, place = trunk, np.zeros(3)
    for parent, child in pairwise(chain):
        place = place + turn @ (body.joint_centre[child] - body.joint_centre[parent])
        turn = turn @ rotation_from_bind(rows, child, pose_deg)
    return turn, place


def _height(body: Body, rows: list[Hinge], pose: dict[str, float], trunk: Array, proxy: Proxy) -> float:
    """Return the height [m] of a sphere's lowest point over the pelvis' joint in a pose."""
    turn, place = segment_pose(body, rows, pose, trunk, proxy.segment)
    return float(place[2] + (turn @ (proxy.centre - body.joint_centre[proxy.segment]))[2]) - proxy.radius_m


def rotation_from_bind(rows: list[Hinge], segment: str, pose_deg: dict[str, float]) -> Array:
    """Return the rotation (3, 3) of a segment relative to its parent at the pose's angles of its hinges."""
    out = np.eye(3)
    for row in rows:
        if row.segment == segment and row.name in pose_deg:
            out = out @ axis_rotation(row.axis, np.radians(pose_deg[row.name] - row.bind_deg))
    return out


def axis_rotation(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) about an axis (3,) by an angle [rad], by Rodrigues' formula."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


HAND_REACH_M, HAND_OVER_TIP_M = 0.10, 0.035
"""Dimensions of the robot's hand, whichever way it is turned: half its width, and the height of its underside over the
tip of the tool when the tip is 5 mm deep in the skin."""
TOP_M = 0.02
"""The top of the arm at a place is the highest skin within this distance of it."""
HALF_SCRUB_M = 0.025
"""Half of the 50 mm along the region that the protocols' scrub has to cover."""
SHARES = np.linspace(0.2, 0.95, 76)
"""Places that are tried, as shares of the arm's length."""


def free_middle(body: Body, segment: str) -> float:
    """Return the share of a limb's length at which the middle of a region beside the trunk lies.

    It is half. If the chest would obstruct a hand there, it is moved toward the next joint until half a scrub toward
    the trunk is free.
    """
    length = float(np.linalg.norm(body.axis_vector(segment)))
    return max(0.5, crowded_until(body, segment) + HALF_SCRUB_M / length)


def crowded_until(body: Body, segment: str) -> float:
    """Return the largest share of an arm's length at which chest or shoulder would touch the hand; 0 if there is none.

    There, skin within reach of the hand is higher than the hand's underside. The person lies with the comfort arm at
    the middle of its range.
    """
    side, _, name = segment.partition("_")
    rows, pose, trunk = hinges(body), lying_pose_deg(body, MIDDLE_ARM_DEG), trunk_rotation(body)

    def lying(on: str, points: Array) -> Array:
        turn, place = segment_pose(body, rows, pose, trunk, on)
        return place + (points - body.joint_centre[on]) @ turn.T

    chest = lying("thorax", body.vertices_of("thorax", f"{side}_clavicle"))
    arm = lying(segment, body.vertices_of(segment, f"{side}_{CHILD_ALONG[name]}"))
    start = lying(segment, body.joint_centre[segment][None])[0]
    along = lying(segment, (body.joint_centre[segment] + body.axis_vector(segment))[None])[0] - start
    for share in SHARES[::-1]:
        at = (start + share * along)[:2]
        top = arm[np.hypot(*(arm[:, :2] - at).T) < TOP_M, 2].max(initial=-np.inf)
        beside = chest[np.hypot(*(chest[:, :2] - at).T) < HAND_REACH_M, 2].max(initial=-np.inf)
        if np.isfinite(top) and beside - top > HAND_OVER_TIP_M:
            return float(share)
    return 0.0
