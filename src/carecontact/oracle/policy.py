"""The oracle: how it touches, scrubs and pushes, given the true force and skin of a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from carecontact.episode.episode import Episode, Teaching
from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action import Action
from carecontact.interface.action_spaces import clip_action
from carecontact.interface.body_view import RegionGeometry
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import ActionBounds
from carecontact.oracle.truth import Foamed, Follower, Truth, hold
from carecontact.policies import state_machine as fixed
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, NEAR_SPEED_M_S, UP, Leg, radial_quat, sample, travel
from carecontact.policies.registry import is_privileged
from carecontact.policies.state_machine import PlanningFailure, push, reachable, scrub, touch, travel_height
from carecontact.protocol.gates import Task
from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]

FORCE_N = 3.0
"""A light, clear press: the middle, as a ratio, of the 1 to 8 N in which people wash (design of the exam's gates)."""
LEAST_N = 1.5
"""Below this force [N], the tool stops along the skin until it presses again."""
MOST_PRESS_N = 5.0
"""Above this force [N], a touch does not count as steady."""
STEADY_S = 1.3
"""A touch lasts until it was steady for this time [s] without interruption; the gate asks for 1 s."""
PATIENCE_S = 5.0
"""Longest time [s] that it waits for a steady touch; then it goes on without one."""
GAIN_M_NS = 0.006
"""Rate of change of the depth [m/s] for each newton that the force is off. At 400 N/m on soft tissue, 1 N is about
3.5 mm, so that the loop has a time constant of 0.6 s, twice the lag of the impedance behind its target."""
EXCESS = 4.0
"""The depth shrinks this many times faster while the force is more than EXCESS_N [N] too large."""
EXCESS_N = 1.5
MOVES_M_S = 0.03
"""Above this speed of the skin, the person changes posture, and the tool is lifted off; breathing is slower."""
CALM = 2
"""Control periods below that speed after which the tool comes down again."""
OFF_M = 0.015
"""Height [m] of the target above the skin while the person moves."""
LIFT_M_S, RETURN_M_S = 0.3, 0.06
"""Speeds [m/s] at which the target leaves the skin and comes back to it."""
FREE_N = 0.5
"""Below this force [N] the tool is off the skin."""
DEEPEST_M = 0.06
"""Largest depth [m] of the target. At 400 N/m it limits the force to 24 N, whatever force was measured."""
MOST_LEAD_M = 0.008
"""Largest lead [m] of the target over a tool that rubs: at 400 N/m, what the friction of a 3 N press on dry skin
takes."""
SMOOTHING = 0.3
"""Share of the newest value in the exponential running mean of that lead."""
RATE_S, MOST_OFFSET_M = 3.0, 0.020
"""The target is moved along the skin at this rate [1/s] until the middle of the contact lies where it was planned, and
by this length [m] at most. Where skin slopes under the hand, a mitt touches it beside the tool centre point."""
FIRST_IN_CONTACT = 3
"""Index of the leg that brings the tool down; the two legs before the last one take it up and away."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    pose: F64
    """(7,) target pose in the robot's base, for where the person lay at the time of planning."""
    presses: bool


def stages(legs: Sequence[Leg], start_pose: F64) -> list[Stage]:
    """Return all control periods of a touch or a scrub. The tool presses between coming down and going up."""
    out: list[Stage] = []
    at = start_pose
    for number, leg in enumerate(legs):
        poses = list(sample([leg], at))
        held = len(poses) - round(leg.hold_s * CONTROL_HZ)
        along = FIRST_IN_CONTACT < number < len(legs) - 2
        out += [
            Stage(pose=pose, presses=along or (number == FIRST_IN_CONTACT and k >= held))
            for k, pose in enumerate(poses)
        ]
        at = np.concatenate([leg.points[-1], leg.quat_wxyz])
    return out


class _Motion:
    """Gives one target for each control period."""

    ended = False
    """Whether the last target was given."""

    def __init__(self, truth: Truth, targets: Iterator[F64]) -> None:
        self._truth, self._follower, self._targets = truth, Follower(truth), targets

    def act(self) -> Action:
        return Action(pose_tcp_in_base=next(self._targets))


class Press(_Motion):
    """A touch or a scrub on the state machine's path, which moves with the skin, at a chosen force."""

    def __init__(
        self,
        truth: Truth,
        plan: Sequence[Stage],
        *,
        rests: bool,
        down: F64 = -UP,
        force_n: float = FORCE_N,
        meets: F64 | None = None,
    ) -> None:
        """
        Args:
            rests: whether the tool stays where it came down until the force has been steady.
            down: (3,) unit vector in which the tool presses.
            force_n: force that is held [N].
            meets: (n, 3) directions along which the middle of the contact is brought to the planned place; None: the
                tool centre point is.
        """
        super().__init__(truth, self._run(plan, rests))
        self._meets = np.zeros((3, 3)) if meets is None else meets.T @ meets
        self._waited, self._down, self._force_n = 0, down, force_n
        self._across = np.eye(3) - np.outer(down, down)

    @property
    def succeeded(self) -> bool:
        """Whether all waits for the skin together stayed below PATIENCE_S."""
        return self._waited < PATIENCE_S * CONTROL_HZ

    def _run(self, plan: Sequence[Stage], rests: bool) -> Iterator[F64]:
        depth_m, steady, longest, lead_m, calm = 0.0, 0, 0, np.zeros(3), CALM
        offset_m = np.zeros(3)
        rests_until = max(k for k, stage in enumerate(plan) if stage.presses) if rests else -1
        at = 0
        while at < len(plan):
            stage, force = plan[at], self._truth.force_n()
            place = self._follower.follow(stage.pose[:3])
            waits = moves = False
            if stage.presses:
                calm = 0 if self._follower.speed_m_s > MOVES_M_S else calm + 1
                moves = calm < CALM
                depth_m = float(np.clip(depth_m + self._sinks(force, depth_m, moves) / CONTROL_HZ, -OFF_M, DEEPEST_M))
                lead_m = lead_m + SMOOTHING * (self._friction_m() - lead_m)
                contact = self._truth.contact()
                if contact is not None and not moves:
                    off_m = self._across @ self._meets @ (self._follower.place - contact)
                    offset_m = _shortened(offset_m + RATE_S * off_m / CONTROL_HZ, MOST_OFFSET_M)
                place = place + depth_m * self._down + lead_m + offset_m
                steady = steady + 1 if LEAST_N <= force <= MOST_PRESS_N else 0
                longest = max(longest, steady)
                unsteady = at == rests_until and longest < STEADY_S * CONTROL_HZ
                waits = (force < LEAST_N or unsteady) and self._waited < PATIENCE_S * CONTROL_HZ
            self._waited += waits and not moves
            at += not (waits or moves)
            self.ended = at == len(plan)
            yield np.concatenate([place, stage.pose[3:]])

    def _sinks(self, force_n: float, depth_m: float, moves: bool) -> float:
        """Return the rate of change of the depth [m/s]. ``moves``: whether the person changes posture."""
        if moves:
            return -LIFT_M_S
        if depth_m < 0 and force_n < FREE_N:
            return RETURN_M_S
        error = self._force_n - force_n
        return GAIN_M_NS * error * (EXCESS if error < -EXCESS_N else 1.0)

    def _friction_m(self) -> F64:
        """Return the vector (3,) [m] along the skin by which friction holds the tool back from its target."""
        lag = self._truth.force() @ self._across / self._truth.simulation.protocol.impedance.translational_n_m
        return _shortened(lag, MOST_LEAD_M)


def _shortened(vector: F64, most: float) -> F64:
    """Return a vector in its direction, no longer than ``most``."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-9))


SPEED_M_S = 0.06
BACK_M_S = FREE_SPEED_M_S
"""Speed [m/s] of retreat, the fastest that the impedance's target may have: the tool gives way to a person who moves
the arm against it."""
WRIST_M = 0.030
"""Distance [m] by which the oracle moves the wrist: a push needs at least 20 mm, and more than 100 mm is rough."""
MOST_WRIST_M = 0.075
"""Displacement [m] of the wrist at which the tool lets go, because the person moves the arm as well: less than 100
mm."""
HOLDS_N = 4.0
"""Force [N] of the push, above the 3 N from which contact counts as a push."""
MOST_PUSH_N = 12.0
"""Above this force [N] the tool gives way: pushing a limb over its board takes 6 to 11 N, and at 20 N a person may
withdraw the arm."""
TOUCHES_N = 0.5
HOLD_S = 1.2
FARTHEST_M = 0.20
"""Largest distance [m] of the target beyond the place where the limb's side was; from there the tool always goes
back."""
PUSHES = 4
"""Index of the leg that pushes."""


class Push(_Motion):
    """Brings the tool beside the limb, then pushes until the wrist has moved."""

    def __init__(self, truth: Truth, legs: Sequence[Leg], start_pose: F64) -> None:
        """``legs``: all legs of a push that ends where the tool just touches the limb."""
        super().__init__(truth, self._run(legs, start_pose))
        self._held = 0

    @property
    def succeeded(self) -> bool:
        """Whether the push kept its force for long enough; if not, the limb moved where the tool did not follow."""
        return self._held >= HOLD_S * CONTROL_HZ

    def _run(self, legs: Sequence[Leg], start_pose: F64) -> Iterator[F64]:
        low, touching, quat = legs[PUSHES - 1].points[-1], legs[PUSHES].points[-1], legs[PUSHES].quat_wxyz
        way = (touching - low) / np.linalg.norm(touching - low)
        for pose in sample(legs[:PUSHES], start_pose):
            yield np.concatenate([self._follower.follow(pose[:3]), pose[3:]])
        # From here on the limb moves because it is pushed: the target no longer follows it.
        origin, on_m, moved_m, wrist_before = self._follower.follow(low), 0.0, 0.0, None
        while not self.succeeded and on_m < FARTHEST_M and moved_m <= MOST_WRIST_M:
            force, wrist = self._truth.force_n(), self._truth.wrist()
            if wrist_before is None and force > TOUCHES_N:
                wrist_before = wrist
            moved_m = 0.0 if wrist_before is None else float(np.linalg.norm((wrist - wrist_before)[:2]))
            enough = moved_m >= WRIST_M and force >= HOLDS_N
            self._held = self._held + 1 if enough else 0
            if force > MOST_PUSH_N:
                on_m -= BACK_M_S / CONTROL_HZ
            elif not enough:
                on_m += SPEED_M_S / CONTROL_HZ
            yield np.concatenate([origin + on_m * way, quat])
        *back, last = sample(legs[PUSHES + 1 :], np.concatenate([low, quat]))
        for pose in (*back, last):
            self.ended = pose is last
            yield np.concatenate([pose[:3] - low + origin, pose[3:]])


AGAIN = 0.6
"""If a motion loses the person before this share of the trial's time, the oracle plans it once more for where the
person lies then."""
DWELL_S = 0.8
"""Wait [s] at the end of a stroke: twice the time constant of the impedance, so that the tool arrives."""
ROOM_M = 0.020
"""Largest distance [m] by which a stroke begins before the near end of a short region. At 400 N/m, 3 N of friction
shorten a stroke by 8 mm."""
STROKES = 2
"""Times back and forth. With the pass before them they make five passes, where three are needed: a person who moves the
arm spoils one or two."""


class Oracle:
    """Is given the true skin, limbs, arm board and contact force; chooses a motion once and follows the person with it.

    Where no primitive reaches the region, it ends the trial without touching and gives the reason in its notes.
    """

    card = PolicyCard(name="oracle", cameras=(), control_hz=CONTROL_HZ)

    def __init__(self, simulation: Simulation, task: Task, bounds: ActionBounds) -> None:
        """
        Args:
            simulation: the trial's, at t = 0. The oracle reads it and never changes it.
            task: the region and the action that the instruction means.
            bounds: the workspace that every target must lie in.
        """
        self._simulation, self._task, self._bounds = simulation, task, bounds
        self._motion: Press | Push | None = None
        self._again_until_s = AGAIN * simulation.protocol.phases.time_limit_s
        self._notes: dict[str, object] = {}

    def act(self, observation: Observation) -> Action:
        return self.target(observation.pose_tcp_in_base, observation.sim_time_s)

    def target(self, tool: F64, time_s: float) -> Action:
        """Return the target for the next control period of a tool (7,) that is there at this time [s]."""
        if self._motion is None:
            try:
                self._motion = self._planned(tool)
            except ContractError as error:
                self._notes["ended_without_touching"] = str(error)
                return Action(done=True)
        inside, motion = clip_action(self._motion.act(), self._bounds), self._motion
        if motion.ended and not motion.succeeded and time_s < self._again_until_s:
            self._motion = None
            return inside
        return replace(inside, done=motion.ended)

    def take_notes(self) -> dict[str, object]:
        """Return the notes: how the hand is held, or why the oracle touched nothing."""
        notes, self._notes = self._notes, {}
        return notes

    def _planned(self, start: F64) -> Press | Push:
        truth = Truth(self._simulation, self._task.region)
        geometry = truth.geometry()
        height = travel_height(truth.skin(), start, geometry.centre_m)
        # The person may move: nothing is planned into the last centimetre of the workspace.
        height = min(height, self._bounds.workspace_high_m[2])
        if self._task.action == "push":
            legs = travel(start, _pushed(geometry), travel_height_m=height)
            return Push(truth, legs, start)
        if self._task.action not in ("touch", "scrub"):
            raise PlanningFailure(f"the oracle has no primitive for the action {self._task.action}")
        rests, spot, down, force_n, meets = self._task.action == "touch", truth.spot(), -UP, FORCE_N, None
        if spot is None:
            contact = self._held(_pressed(geometry, self._task.action))
        else:
            contact = self._held(_at_foam(spot, self._task.action), list(spot.ways()))
            down, force_n = matrix_from_quat(contact[0].quat_wxyz)[:, 2], FORCE_N if rests else WASH_N
            # Strokes are shorter than the patch, and the contact may lie ahead or behind.
            meets = spot.axes.T[:2] if rests else spot.axes.T[1:2]
        plan = stages(travel(start, contact, travel_height_m=height), start)
        return Press(truth, plan, rests=rests, down=down, force_n=force_n, meets=meets)

    def _held(self, contact: Sequence[Leg], ways: Sequence[F64] = ()) -> list[Leg]:
        """Turn the hand of a motion so that it keeps clear of the rest of the person. ``ways``: as in ``hold``."""
        held = hold(self._simulation, self._task.region, _places(contact), ways)
        clear_mm = round(1000 * held.clear_m, 1)
        self._notes |= {"hand_quat_wxyz": held.quat_wxyz.round(4).tolist(), "hand_clear_mm": clear_mm}
        self._notes["hand_reaches"] = held.reached
        if not held.reached:
            raise PlanningFailure(f"the arm cannot reach the {self._task.region} with any hold of the hand")
        return [replace(leg, quat_wxyz=held.quat_wxyz) for leg in contact]


def _pressed(geometry: RegionGeometry, action: str) -> list[Leg]:
    """Put the motion on the skin instead of below it, because the force control adds the depth (``Press``)."""
    if action == "touch":
        return touch(geometry, key_point=0.5, depth_m=0.0, speed_m_s=fixed.TOUCH_SPEEDS_M_S[0])
    legs = scrub(_with_room(geometry), key_point=0.5, depth_m=0.0, speed_m_s=fixed.SCRUB_SPEEDS_M_S[0])
    *contact, back, forth, up = (replace(leg, hold_s=DWELL_S) if leg.hold_s else leg for leg in legs)
    return [*contact, *(back, forth) * STROKES, up]


WASH_N = 4.5
"""Force [N] with which foam is wiped: near the middle of the 1 to 8 N of a scrub."""
LANES_M = (-0.013, 0.0, 0.013)
"""Where the strokes over foam lie across it [m]."""
LANE_PASSES = 3
"""As many as a cell needs to be clean (``scoring.foam.PASSES``)."""
REACH_M = 0.016
"""How far short of the foam's end a stroke ends: the mitt reaches that far and more."""
WIPE_M_S = 0.06
"""Speed of a stroke over foam: at the usual 70 mm/s the force rises on the slope of a flank before the loop lowers
it."""
WIPE_DWELL_S = 0.25


def _at_foam(spot: Foamed, action: str) -> list[Leg]:
    """A touch of the foam's middle, or strokes along it, side by side, with the hand as yet unturned."""
    middle, clear = spot.surface(np.zeros(2)), fixed.HOVER_M * spot.out()
    quat = radial_quat(middle)
    if action == "touch":
        return fixed.touch_at(middle, quat, spot.out(), 0.0, fixed.DESCENT_SPEED_M_S)
    half = spot.half_m[0] - REACH_M
    along = np.linspace(-half, half, 2 * int(np.ceil(half / fixed.SCRUB_STEP_M)) + 1)
    legs, way = list[Leg](), 1
    for lane in LANES_M:
        stroke = np.array([spot.surface(np.array([s, lane])) for s in along])[::way]
        legs.append(Leg.to(stroke[0], quat, fixed.DESCENT_SPEED_M_S, hold_s=WIPE_DWELL_S))
        for _ in range(LANE_PASSES):
            legs.append(Leg(points=stroke[1:], quat_wxyz=quat, speed_m_s=WIPE_M_S, hold_s=WIPE_DWELL_S))
            stroke, way = stroke[::-1], -way
    first, last = legs[0].points[-1], legs[-1].points[-1]
    return [
        Leg.to(first + clear, quat, FREE_SPEED_M_S),
        *legs,
        Leg.to(last + clear, quat, NEAR_SPEED_M_S),
    ]


def _with_room(geometry: RegionGeometry) -> RegionGeometry:
    """Lengthen a short region at its near end. Friction ends a stroke early, and a joint lies at the far end."""
    whole = fixed.SCRUB_HALF_STROKE_M + fixed.SCRUB_END_MARGIN_M
    room = float(np.clip(whole - geometry.half_length_m, 0.0, ROOM_M / 2))
    centre, profile = geometry.centre_m - room * geometry.axis, geometry.profile_m + [room, 0.0]
    return replace(geometry, centre_m=centre, half_length_m=geometry.half_length_m + room, profile_m=profile)


def _pushed(geometry: RegionGeometry) -> list[Leg]:
    if geometry.support_height_m is None:
        raise PlanningFailure(f"the {geometry.region} lies on nothing from which it could be pushed")
    lightest = {"key_point": fixed.PUSH_KEY_POINTS[-1], "depth_m": 0.0, "speed_m_s": fixed.PUSH_SPEEDS_M_S[0]}
    for side in (True, False):
        contact = push(geometry, **lightest, support_height_m=geometry.support_height_m, towards_base=side)
        if reachable(contact):
            return contact
    raise PlanningFailure(f"the arm reaches no side of the {geometry.region}")


def _places(contact: Sequence[Leg]) -> F64:
    """Return the places (n, 3) [m] where the tool comes down, and both ends of every stroke."""
    down, *strokes = contact[1:-1]
    ends = [leg.points[[0, -1]] for leg in strokes[:2]]
    return np.vstack([down.points[-1:], *ends])


PRIVILEGED = {"oracle": Oracle}
"""Every policy that is ever given a simulation: the classes of this package and no other, whatever a row says."""


def drive(
    episode: Episode, ref: PolicyRef, prepared: Callable[[], Teaching] = lambda: lambda action: (action, None)
) -> None:
    """Run a privileged policy, which is given the episode's simulation; the recording says ``privileged``.

    ``prepared``: gives what turns its actions into demonstrations, once the episode has begun.

    Raises ConfigError for a policy that is not one of PRIVILEGED.
    """
    if ref.name not in PRIVILEGED or not is_privileged(ref):
        raise ConfigError(f"policy {ref}: only {', '.join(PRIVILEGED)} may be given the simulation of a trial")
    made = PRIVILEGED[ref.name]
    episode.card, episode.privileged = made.card, True
    observation = episode.reset()
    policy = made(episode.simulation, episode.task, episode.session.action_bounds)
    teach = prepared()
    while observation is not None:
        executed, demonstrated = teach(policy.act(observation))
        episode.answered(notes=policy.take_notes())
        observation = episode.step(executed, demonstrated=demonstrated).observation
