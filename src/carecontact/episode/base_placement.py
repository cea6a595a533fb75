"""Where the robot's base can stand beside a lying person: what a place must let the arm do."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from carecontact.cache import Arrays
from carecontact.human.pose import BOARD_HEIGHT_M
from carecontact.human.skeleton import body_name
from carecontact.interface.regions import REGIONS, Tube
from carecontact.protocol.gates import Vec3
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import BasePlacement
from carecontact.sim.simulation import Simulation
from carecontact.world.arm_kinematics import Arm, follow
from carecontact.world.draws import Place, Posture, overhead_of, place_of
from carecontact.world.scene import build_scene

Array = npt.NDArray[np.float64]

ALONG_M = 0.06
"""Distance [m] of both ends of a scrub from the middle of a region (``policies.state_machine.SCRUB_HALF_STROKE_M``)."""
NEAR_M = 0.025
"""The height of the skin at a place is that of the highest vertex within this horizontal distance [m]."""
EVERY = 12
"""Every twelfth vertex stands for the body: about 1,000 vertices, some 30 mm apart."""
ARM_PARTS = ("right_upper_arm", "right_forearm", "right_hand")
OUT_OF_THE_WAY_M = (0.0, 4.0, 0.55)
"""Place [m] of the robot's base while the person settles, far away from the bed."""


@dataclass(frozen=True, kw_only=True)
class LyingPerson:
    """A person who has settled. All points are in the world [m]."""

    skin: Array
    """(R, 3, 3) highest skin over the axis of each region, at its middle and ALONG_M either way"""
    limb: Array
    """(4, 3) shoulder, elbow, wrist and finger tips of the right arm"""
    cloud: Array
    """(n, 3) vertices of the body"""
    on_arm: npt.NDArray[np.bool_]
    """(n,) whether each of these vertices belongs to the right arm"""
    pelvis: Array
    """(3,) middle of the pelvis"""

    def at(self, place: Place) -> LyingPerson:
        """Return the same person at another place on the bed."""
        return replace(self, **{name: place.moved(getattr(self, name)) for name in ("skin", "limb", "cloud", "pelvis")})

    def repositioned(self, wrist_m: float, regions: tuple[str, ...]) -> LyingPerson:
        """Return the person with the arm turned about the vertical through the shoulder, so far that the wrist moves
        this far."""
        shoulder = self.limb[0]
        angle = wrist_m / float(np.hypot(*(self.limb[2] - shoulder)[:2]))
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        mine = np.array([REGIONS[name].segment in ARM_PARTS for name in regions])

        def turned(points: Array) -> Array:
            return shoulder + (points - shoulder) @ turn.T

        return replace(
            self,
            skin=np.where(mine[:, None, None], turned(self.skin), self.skin),
            limb=turned(self.limb),
            cloud=np.where(self.on_arm[:, None], turned(self.cloud), self.cloud),
        )

    def arrays(self) -> Arrays:
        return {field.name: getattr(self, field.name) for field in fields(self)}


def lying_person(protocol: Protocol, comfort_arm_deg: float) -> LyingPerson:
    """Let the person settle in the protocol's own place with the robot far away; raises as a trial's world does."""
    away = protocol.scene.model_copy(update={"robot_base_m": OUT_OF_THE_WAY_M})
    simulation = Simulation(build_scene(protocol.model_copy(update={"scene": away}), target=None, skin=False))
    simulation.settle(comfort_arm_deg)
    data, body = simulation.data, simulation.scene.body
    limb = [data.body(body_name(segment)).xpos for segment in ARM_PARTS]
    reach = data.body(body_name("right_hand")).xmat.reshape(3, 3) @ body.axis_vector("right_hand")
    owner = body.weight_segment[::EVERY, 0]
    segments = [body.segments[k] for k in owner]
    frames = [data.body(body_name(segment)) for segment in segments]
    offsets = body.vertices[::EVERY] - np.array([body.joint_centre[segment] for segment in segments])
    turns = np.array([frame.xmat.reshape(3, 3) for frame in frames])
    return LyingPerson(
        skin=np.array([_skin(simulation, region) for region in protocol.regions]),
        limb=np.array([*limb, limb[2] + 2.0 * reach]),
        cloud=np.array([frame.xpos for frame in frames]) + np.einsum("nij,nj->ni", turns, offsets),
        on_arm=np.isin(segments, ARM_PARTS),
        pelvis=data.body(body_name("pelvis")).xpos.copy(),
    )


def _skin(simulation: Simulation, region: str) -> Array:
    """Return three places (3, 3) [m] of the skin above a region's axis: its middle, and ALONG_M either way."""
    site = simulation.data.site(f"region_{region}")
    along = site.xmat.reshape(3, 3)[:, 0]
    places = site.xpos + np.array([-ALONG_M, 0.0, ALONG_M])[:, None] * along
    felt = simulation.tissue.get(region)
    if felt is None:
        out = simulation.scene.frames[region].size_m[2]
        return places + [0.0, 0.0, out]
    data = simulation.data
    points = data.xpos[felt.bone] + felt.vertices(data) @ data.xmat[felt.bone].reshape(3, 3).T
    for place in places:
        near = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < NEAR_M]
        if len(near):
            place[2] = near[:, 2].max()
    return places


Refusal = Literal["bed", "board", "limb", "reach", "workspace", "parked tool", "shadow", "path", "joints", "posture"]
REFUSALS: tuple[Refusal, ...] = get_args(Refusal)
"""Why a base does not serve, in the order of the checks: the pedestal would stand in the bed, in the arm board or too
close to the arm; the wrist would be too near to the robot's shoulder or too far from it; a target lies outside the
workspace; the parked tool is too close to the person; the parked arm hides the limb from the overhead camera; the arm
cannot follow the straight way to a target; a joint comes to the end of its range; the posture is nearly singular."""

HOVER_M, PRESS_M = 0.07, -0.02
"""Heights over the skin that the tool must reach: above every hover of the shipped policies, and as deep as a press."""
INSIDE_M = 0.02
"""Least distance [m] of every target from the sides of the workspace."""
BED_HALF_WIDTH_M, BED_GAP_M = 0.45, 0.10
BOARD_GAP_M, LIMB_GAP_M, MOVED_LIMB_GAP_M = 0.09, 0.22, 0.17
"""Least distance [m] of the pedestal's axis from the arm board, from the middle of the limb, and from the middle of a
limb that the person has moved. The pedestal has a radius of 0.09 m, and its plate one of 0.125 m."""
TOOL_GAP_M = 0.10
"""Least distance [m] of the parked tool from the person's skin, also after the arm has moved, and in the picture from
the middle of the limb."""
LINK_SHADOW_M, BODY_SHADOW_M = 0.14, 0.27
"""Least distance [m] in the overhead image, measured at the height of the limb: of a link's line from the limb's line
(half a link, half a limb and 20 mm), and from the middle of the pelvis, so that the trunk is visible."""
LIMB_OVER_BED_M = 0.08
PUSH_OVER_BOARD_M = 0.018
"""Height [m] over the arm board of a tool that pushes a limb aside."""
PATH_STEPS, PATH_ERROR = 16, 3e-3
"""Number of steps of the straight path, and the largest error along it: one norm of [m] and [rad]."""
LEAST_MARGIN, LEAST_MANIPULABILITY = 0.05, 0.025
"""Least distance of a joint from the end of its range, as a share of half the range, and least manipulability
sqrt(det(J J^T)). At the fixed base, the worst target has a manipulability of 0.05."""


@dataclass(frozen=True, kw_only=True)
class Base:
    """A place of the robot's base in the world."""

    position_m: Vec3
    yaw_deg: float

    @property
    def turn(self) -> Array:
        """(3, 3) rotation from the base to the world."""
        cos, sin = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


class PlacementCheck:
    """One person in one place on one level, and what the robot must keep clear of."""

    def __init__(self, protocol: Protocol, seed: int, salt: str, person: LyingPerson, posture: Posture) -> None:
        """``person``: as they settled with this posture in the protocol's own place."""
        scene, place, wrist_m = protocol.scene, place_of(posture.place, protocol.variation), farthest_wrist_m(protocol)
        self.protocol, self.overhead, self.laid = protocol, overhead_of(protocol, seed, salt), person.at(place)
        ways = (-1.0, 1.0) if wrist_m else ()
        self.moved = [self.laid.repositioned(way * wrist_m, protocol.regions) for way in ways]
        """The same person after moving the arm as far as any level allows, in either direction."""
        low, high = np.array([*scene.board_low_m, 0.0]), np.array([*scene.board_high_m, 0.0])
        self._board_turn = (place.moved(np.eye(3)) - place.moved(np.zeros(3))).T
        self._board_middle, self._board_half = place.moved((low + high) / 2), (high - low)[:2] / 2
        # Points (n, 3) along the limb, along the limb after it moved, and of the person wherever they may be.
        self._limb = _points_along(self.laid.limb)
        self._moved_limb = np.concatenate([np.zeros((0, 3)), *(_points_along(moved.limb) for moved in self.moved)])
        self._cloud = np.concatenate([self.laid.cloud, *(moved.cloud[moved.on_arm] for moved in self.moved)])
        self._arm = Arm(scene.robot)
        # (joints + 2, 4, 4) poses of the parked arm's links in the robot's base.
        self._parked = self._arm.links(np.array([scene.parked_joint_rad]))[0]

    def targets(self, region: str, laid: LyingPerson) -> Array:
        """Return the places (n, 3) [m] in the world that the tool centre point must be able to reach."""
        skin = laid.skin[self.protocol.regions.index(region)]
        levels = [skin + [0.0, 0.0, HOVER_M], skin + [0.0, 0.0, PRESS_M]]
        shape = REGIONS[region].shape
        if isinstance(shape, Tube) and shape.pushed_from_side:
            top = self.protocol.scene.mattress_top_m + BOARD_HEIGHT_M + PUSH_OVER_BOARD_M
            levels.append(np.column_stack([skin[:, :2], np.full(len(skin), top)]))
        return np.concatenate(levels)

    def refusal(self, base: Base, region: str) -> Refusal | None:
        """Return why the robot may not stand at a base for a task on a region; None if it may."""
        at, turn = np.array(base.position_m), base.turn
        targets = self.targets(region, self.laid)
        found = self._in_the_way(at) or self._out_of_reach((targets - at) @ turn, self._arm.reach.wrist_m)
        if found is None and self.moved:
            moved = np.concatenate([self.targets(region, laid) for laid in self.moved])
            found = self._out_of_reach((moved - at) @ turn, self._arm.reach.moved_wrist_m)
            targets = np.unique(np.concatenate([targets, moved]), axis=0)
        return found or self._over_the_person(at, turn) or self._awkward(base, targets)

    def _in_the_way(self, at: Array) -> Refusal | None:
        if at[1] < BED_HALF_WIDTH_M + BED_GAP_M:
            return "bed"
        beside = ((at - self._board_middle) @ self._board_turn)[:2]
        if np.linalg.norm(np.maximum(np.abs(beside) - self._board_half, 0.0)) < BOARD_GAP_M:
            return "board"
        for limb, gap in ((self._limb, LIMB_GAP_M), (self._moved_limb, MOVED_LIMB_GAP_M)):
            if np.linalg.norm((limb - at)[:, :2], axis=1).min(initial=np.inf) < gap:
                return "limb"
        return None

    def _out_of_reach(self, local: Array, wrist_m: tuple[float, float]) -> Refusal | None:
        """Check targets (n, 3) [m] in the robot's base, for a tool that points down and away from the base."""
        reach = self._arm.reach
        level = np.hypot(local[:, 0], local[:, 1]) - reach.wrist_offset_m
        distance = np.hypot(level, local[:, 2] + reach.wrist_to_tcp_m - reach.shoulder_height_m)
        if distance.min() < wrist_m[0] or distance.max() > wrist_m[1]:
            return "reach"
        impedance = self.protocol.impedance
        low, high = np.array(impedance.workspace_low_m), np.array(impedance.workspace_high_m)
        outside = (local < low + INSIDE_M) | (local > high - INSIDE_M)
        return "workspace" if outside.any() else None

    def _over_the_person(self, at: Array, turn: Array) -> Refusal | None:
        origins = self._parked[:, :3, 3] @ turn.T + at
        tool = origins[-1]
        if (
            np.linalg.norm(self._cloud - tool, axis=1).min() < TOOL_GAP_M
            or np.linalg.norm((self._limb - tool)[:, :2], axis=1).min() < TOOL_GAP_M
        ):
            return "parked tool"
        line = np.concatenate([origins[:-1] + share * (origins[1:] - origins[:-1]) for share in (0.0, 0.5, 1.0)])
        eye, level = np.array(self.overhead.position_m), self.protocol.scene.mattress_top_m + LIMB_OVER_BED_M
        grown = ((eye[2] - level) / (eye[2] - line[:, 2]))[:, None]
        shadow = eye[:2] + (line[:, :2] - eye[:2]) * grown
        gap = np.linalg.norm(shadow[:, None] - self._limb[None, :, :2], axis=2).min()
        hides = gap < LINK_SHADOW_M or shadow[:, 1].min() - self.laid.pelvis[1] < BODY_SHADOW_M
        return "shadow" if hides else None

    def _awkward(self, base: Base, targets: Array) -> Refusal | None:
        """Check the straight paths from the parked pose to the targets, which the impedance would take."""
        start = base.turn @ self._parked[-1, :3, :3]
        yaw = np.arctan2(start[1, 0], start[0, 0])
        out = targets - np.array(base.position_m)
        count, way = len(targets), np.arctan2(out[:, 1], out[:, 0])
        parked, yaws = np.tile(self.protocol.scene.parked_joint_rad, (count, 1)), np.full(count, yaw)
        path, error = follow(self._arm, parked, out @ base.turn, way, yaws, base.turn, steps=PATH_STEPS)
        if error.max() > PATH_ERROR:
            return "path"
        if self._arm.margin(path.reshape(-1, path.shape[-1])).min() < LEAST_MARGIN:
            return "joints"
        manipulability, _ = self._arm.measures(path[-1])
        return "posture" if manipulability.min() < LEAST_MANIPULABILITY else None


def _points_along(line: Array) -> Array:
    """Return points (n, 3) on a line through corners (k, 3)."""
    share = np.linspace(0.0, 1.0, 6)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(line)])


def farthest_wrist_m(protocol: Protocol) -> float:
    """Return how far [m] the person may move the wrist along the board on any level."""
    return max((level.reposition_m for level in protocol.levels.values()), default=0.0)


NEAREST_STEP = 0.005
"""Share of the whole range by which, for parking ``nearest``, the range of the draws grows with each further draw."""


def base_draws(
    parking: BasePlacement, region: str, *, place: np.random.Generator, height: np.random.Generator
) -> Iterator[Base]:
    """Yield as many bases as the protocol tries, in their order."""
    level, upright = _of_region(place, region), _of_region(height, region)
    middle, spread = np.array(parking.centre_m), np.array(parking.spread_m)
    for number in range(parking.tries):
        x, y, turn = level.uniform(-1.0, 1.0, 3)
        z = upright.uniform(-1.0, 1.0)
        reach = min(1.0, NEAREST_STEP * number) if parking.manner == "nearest" else 1.0
        at = middle + reach * np.array([x, y, z]) * spread
        yaw_deg = float(parking.centre_yaw_deg + reach * turn * parking.spread_yaw_deg)
        yield Base(position_m=(float(at[0]), float(at[1]), float(at[2])), yaw_deg=yaw_deg)


def _of_region(stream: np.random.Generator, region: str) -> np.random.Generator:
    """Return a generator whose draws do not depend on how many draws another region needed."""
    words = np.frombuffer(hashlib.sha256(region.encode()).digest(), "<u4").tolist()
    return np.random.default_rng([*stream.integers(2**32, size=4).tolist(), *words])
