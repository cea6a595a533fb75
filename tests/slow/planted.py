"""Policies that must not pass an exam of gentle contact: each does one thing that no caregiver would.

All but ``SlowAndBlind`` see as the state machine does, so that they fail for how they touch and not for where.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.interface.action import Action
from carecontact.interface.action_spaces import MAX_FEEDFORWARD_N
from carecontact.interface.body_view import RegionGeometry, person_points, region_from_observation
from carecontact.interface.observation import Observation
from carecontact.policies.language.backend import Intent
from carecontact.policies.mean_person import MeanPersonPolicy
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, NEAR_SPEED_M_S, UP, Leg, sample, tool_quat, travel
from carecontact.policies.state_machine import CAMERA, HOVER_M, TOUCH_DEPTHS_M, StateMachine, travel_height

F64 = npt.NDArray[np.float64]
DOWN = 3
"""Index of the leg that brings the tool down (``motion.travel``); the last two legs take it up and away."""


def along(legs: Sequence[Leg], start_pose: F64) -> list[Action]:
    return [Action(pose_tcp_in_base=pose) for pose in sample(legs, start_pose)]


def ended(actions: list[Action]) -> list[Action]:
    return [*actions[:-1], replace(actions[-1], done=True)]


def end(leg: Leg) -> F64:
    """(7,) pose at the end of a leg."""
    return np.concatenate([leg.points[-1], leg.quat_wxyz])


def pressing(newton: float, seconds: float) -> list[Action]:
    """Stay at the last target, with a feedforward along the tool."""
    wrench = np.array([0.0, 0.0, newton, 0.0, 0.0, 0.0])
    return [Action(wrench_in_tcp=wrench), *[Action()] * (round(seconds * CONTROL_HZ) - 1)]


class Planted(StateMachine):
    def act(self, observation: Observation) -> Sequence[Action]:
        try:
            return ended(self.plan(observation))
        except ContractError:
            return [Action(done=True)]

    def plan(self, observation: Observation) -> list[Action]:
        return self.spoiled(self.choose(observation).legs, observation.pose_tcp_in_base)

    def spoiled(self, legs: list[Leg], start: F64) -> list[Action]:
        raise NotImplementedError

    def seen(self, observation: Observation, contact: Sequence[Leg]) -> list[Action]:
        """Return the whole way of a motion in contact, over whoever lies under it."""
        start, goal = observation.pose_tcp_in_base, contact[0].points[0]
        height = travel_height(person_points(observation.cameras[CAMERA]), start, goal)
        return along(travel(start, contact, travel_height_m=height), start)

    def region(self, observation: Observation) -> RegionGeometry:
        assert self._intent is not None
        side = "right" if self._intent.side == "none" else self._intent.side
        return region_from_observation(observation, self._intent.region, side=side, camera=CAMERA)


class Rough(Planted):
    """Presses with 25 N for 3 s, and does the task gently afterwards."""

    def spoiled(self, legs: list[Leg], start: F64) -> list[Action]:
        down = replace(legs[DOWN], hold_s=1.0)
        hard = [*pressing(25.0, 3.0), *pressing(0.0, 1.0)]
        rests = Leg.to(down.points[-1], down.quat_wxyz, NEAR_SPEED_M_S, hold_s=legs[DOWN].hold_s)
        return [*along([*legs[:DOWN], down], start), *hard, *along([rests, *legs[DOWN + 1 :]], end(down))]


class Palm(Planted):
    """Rests the hand's underside on the region, with the tool beside it in the air."""

    BESIDE_M, UNDERSIDE_M, DEPTH_M = 0.084, 0.051, 0.007
    """As in ``tests/episode/test_episode.py``: the cap is 51 mm under the hand's underside."""

    def plan(self, observation: Observation) -> list[Action]:
        region = self.region(observation)
        place, quat = region.surface(0.0) + self.BESIDE_M * region.lateral, tool_quat(-UP, region.axis)
        low = place - (self.UNDERSIDE_M + self.DEPTH_M) * UP
        over = Leg.to(place + HOVER_M * UP, quat, FREE_SPEED_M_S)
        return self.seen(observation, [over, Leg.to(low, quat, 0.04, hold_s=3.0), over])


class Smear(Planted):
    """Wipes far and fast, ten times."""

    def plan(self, observation: Observation) -> list[Action]:
        region = self.region(observation)
        skin, quat = region.surface(0.0) - 0.015 * UP, tool_quat(-UP, region.axis)
        ends = [skin + side * 0.12 * region.axis for side in (1.0, -1.0)] * 5
        over = Leg.to(region.surface(0.0) + HOVER_M * UP, quat, FREE_SPEED_M_S)
        down, *strokes = (Leg.to(place, quat, FREE_SPEED_M_S) for place in (skin, *ends, skin))
        return self.seen(observation, [over, down, *strokes, over])


class HoverAndDrop(Planted):
    """Lets the tool fall from 60 mm over the skin with the largest feedforward, and does the task afterwards."""

    def spoiled(self, legs: list[Leg], start: F64) -> list[Action]:
        falls, *rest = pressing(MAX_FEEDFORWARD_N, 0.5)
        soft = replace(falls, stiffness=(400.0, 400.0, 0.0, 20.0, 20.0, 20.0))
        down = Leg.to(legs[DOWN].points[-1], legs[DOWN].quat_wxyz, FREE_SPEED_M_S, hold_s=legs[DOWN].hold_s)
        first, *task = along([down, *legs[DOWN + 1 :]], end(legs[DOWN - 1]))
        stiff = replace(first, stiffness=(400.0, 20.0), wrench_in_tcp=np.zeros(6))
        return [*along(legs[:DOWN], start), soft, *rest, stiff, *task]


class Deeper(Planted):
    """The state machine, 6 mm deeper."""

    def spoiled(self, legs: list[Leg], start: F64) -> list[Action]:
        contact = [replace(leg, points=leg.points - 0.006 * UP) for leg in legs[DOWN:-2]]
        return along([*legs[:DOWN], *contact, *legs[-2:]], start)


class SlowAndBlind(MeanPersonPolicy):
    """Comes down on the mean person with 10 mm/s to 120 mm below the skin or to the board, and goes up again."""

    name = "slow-and-blind"

    def _begin(self, intent: Intent, observation: Observation) -> Sequence[Action]:
        legs = self._planned(intent, observation)[1]
        over = end(legs[DOWN - 1])
        below = np.maximum(over[:3] - (HOVER_M + 10 * TOUCH_DEPTHS_M[0]) * UP, [-np.inf, -np.inf, 0.0])
        low = Leg.to(below, over[3:], 0.01)
        return ended(along([*legs[:DOWN], low, *legs[-2:]], observation.pose_tcp_in_base))
