"""The oracle: the state machine's primitives on what is really there, looked up again in every control period."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.action.spaces.cartesian_pose import clip_action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Task
from carecontact.contract.session import ActionBounds
from carecontact.errors import ContractError
from carecontact.oracle.hand import hold
from carecontact.oracle.press import Press, stages
from carecontact.oracle.push import Push
from carecontact.oracle.truth import Truth
from carecontact.policies.motion import CONTROL_HZ, Leg, travel
from carecontact.policies.state_machine import fixed_values as fixed
from carecontact.policies.state_machine.candidates import PlanningFailure, reachable
from carecontact.policies.state_machine.primitives import push, scrub, touch, travel_height
from carecontact.sight import RegionGeometry
from carecontact.sim.simulation import Simulation

F64 = npt.NDArray[np.float64]

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
        """Return the target for the next control period."""
        if self._motion is None:
            try:
                self._motion = self._planned(observation.pose_tcp_in_base)
            except ContractError as error:
                self._notes["ended_without_touching"] = str(error)
                return Action(done=True)
        inside, motion = clip_action(self._motion.act(), self._bounds), self._motion
        if motion.ended and not motion.succeeded and observation.sim_time_s < self._again_until_s:
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
        contact = self._held(_pressed(geometry, self._task.action))
        plan = stages(travel(start, contact, travel_height_m=height), start)
        return Press(truth, plan, rests=self._task.action == "touch")

    def _held(self, contact: Sequence[Leg]) -> list[Leg]:
        """Turn the hand of a motion so that it keeps clear of the rest of the person."""
        held = hold(self._simulation, self._task.region, _places(contact))
        self._notes |= {
            "hand_quat_wxyz": held.quat_wxyz.round(4).tolist(), "hand_clear_mm": round(1000 * held.clear_m, 1),
            "hand_reaches": held.reached,
        }  # fmt: skip
        if not held.reached:
            raise PlanningFailure(f"the arm cannot reach the {self._task.region} with any hold of the hand")
        return [replace(leg, quat_wxyz=held.quat_wxyz) for leg in contact]


def _pressed(geometry: RegionGeometry, action: str) -> list[Leg]:
    """Put the motion on the skin instead of below it, because the force control adds the depth (``oracle.press``)."""
    if action == "touch":
        return touch(geometry, key_point=0.5, depth_m=0.0, speed_m_s=fixed.TOUCH_SPEEDS_M_S[0])
    legs = scrub(_with_room(geometry), key_point=0.5, depth_m=0.0, speed_m_s=fixed.SCRUB_SPEEDS_M_S[0])
    *contact, back, forth, up = (replace(leg, hold_s=DWELL_S) if leg.hold_s else leg for leg in legs)
    return [*contact, *(back, forth) * STROKES, up]


def _with_room(geometry: RegionGeometry) -> RegionGeometry:
    """Lengthen a short region at its near end. Friction ends a stroke early, and the far end has no room because a
    joint lies there.
    """
    whole = fixed.SCRUB_HALF_STROKE_M + fixed.SCRUB_END_MARGIN_M
    room = float(np.clip(whole - geometry.half_length_m, 0.0, ROOM_M / 2))
    return replace(
        geometry, centre_m=geometry.centre_m - room * geometry.axis, half_length_m=geometry.half_length_m + room,
        profile_m=geometry.profile_m + [room, 0.0],
    )  # fmt: skip


def _pushed(geometry: RegionGeometry) -> list[Leg]:
    if geometry.support_height_m is None:
        raise PlanningFailure(f"the {geometry.region} lies on nothing from which it could be pushed")
    for towards_base in (True, False):
        contact = push(
            geometry, key_point=fixed.PUSH_KEY_POINTS[-1], depth_m=0.0, speed_m_s=fixed.PUSH_SPEEDS_M_S[0],
            support_height_m=geometry.support_height_m, towards_base=towards_base,
        )  # fmt: skip
        if reachable(contact):
            return contact
    raise PlanningFailure(f"the arm reaches no side of the {geometry.region}")


def _places(contact: Sequence[Leg]) -> F64:
    """Return the places (n, 3) [m] where the tool comes down, and both ends of every stroke."""
    down, *strokes = contact[1:-1]
    ends = [leg.points[[0, -1]] for leg in strokes[:2]]
    return np.vstack([down.points[-1:], *ends])
