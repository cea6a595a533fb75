"""Look, press with a constant force, look again: `carecontact run --policy look_and_press:LookAndPress` from here.

The overhead camera takes a picture when the policy asks for one; the robot's encoders come at 20 Hz without asking. A
picture tells where the skin is to about 10 mm, and 10 mm more or less of a stiff tool are 4 N. Therefore, the tool goes
to a place above the skin, and from there nothing but a feedforward of 3 N moves it along its own axis: it comes down
until the skin carries these 3 N, wherever the skin is, and follows a person who breathes. Its encoders say when it
rests. Then it stays or strokes, goes home, and looks whether the person still lies where they lay.
"""

import numpy as np

from carecontact.interface.action import Action
from carecontact.interface.body_view import PerceptionFailure, person_points, region_from_observation
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.policies.language.backend import Rules
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, UP, Leg, radial_quat, sample, travel
from carecontact.policies.state_machine import travel_height

FORCE_N, OVER_M = 3.0, 0.03
FIRM, FREE_ALONG_TOOL = (400.0, 20.0), (400.0, 400.0, 0.0, 20.0, 20.0, 20.0)
PRESSED = np.array([0.0, 0.0, FORCE_N, 0.0, 0.0, 0.0])
RESTS, REST_M = 3, 0.0005  # so many ticks in a row with no more travel than this are a rest
MISSED_M, MOVED_M = 0.05, 0.03  # no person is so far under the seen skin; a person who moved farther is tried again


class LookAndPress:
    card = PolicyCard(
        name="look-and-press", modalities=("depth", "points", "masks", "landmarks"), cameras=("overhead",),
        control_hz=CONTROL_HZ, camera_hz={"overhead": 0},
    )  # fmt: skip

    def reset(self, instruction: str) -> None:
        self._intent, self._motion = Rules().parse(instruction), None

    def act(self, observation: Observation) -> Action:
        """Return the next action of a motion that is written as if it ran by itself, and waits at each ``yield``."""
        if self._motion is None:
            self._motion = self._whole(observation)
            return next(self._motion)
        return self._motion.send(observation)

    def _whole(self, seen: Observation):
        home, before = seen.pose_tcp_in_base, np.full(3, np.inf)
        for _ in range(3):
            try:
                region = region_from_observation(seen, self._intent.region, side=self._intent.side)
            except PerceptionFailure:
                break
            if np.linalg.norm(region.centre_m - before) < MOVED_M:
                break
            before, quat = region.centre_m, radial_quat(region.centre_m)
            height = travel_height(person_points(seen.cameras["overhead"]), home, region.centre_m)
            over = Leg.to(region.centre_m + OVER_M * UP, quat, FREE_SPEED_M_S, hold_s=0.5)
            way = travel(seen.pose_tcp_in_base, [over], travel_height_m=height)
            for pose in sample(way[:-1], seen.pose_tcp_in_base):
                seen = yield Action(pose_tcp_in_base=pose)
            seen = yield from self._press(region, np.concatenate([over.points[0], quat]))
            back = [way[-1], Leg.to(np.array([*home[:2], height]), home[3:], FREE_SPEED_M_S, hold_s=0.5)]
            for pose in sample(back, seen.pose_tcp_in_base):
                seen = yield Action(pose_tcp_in_base=pose, stiffness=FIRM, wrench_in_tcp=np.zeros(6))
            seen = yield Action(look=("overhead",))
        return (yield Action(done=True))

    def _press(self, region, above):
        stay = Leg.to(above[:3], above[3:], 0.05, hold_s=2.0)
        ends = [np.array([*region.surface(s * region.half_length_m)[:2], above[2]]) for s in (0.6, -0.6)]
        strokes = [Leg.to(end, above[3:], 0.08, hold_s=0.3) for end in (*ends, *ends)]
        path = sample([*strokes, stay] if self._intent.action == "scrub" else [stay], above)
        pose, rests, last_m = above, 0, np.inf
        while pose is not None:
            seen = yield Action(pose_tcp_in_base=pose, stiffness=FREE_ALONG_TOOL, wrench_in_tcp=PRESSED)
            height_m = seen.pose_tcp_in_base[2]
            if height_m < region.centre_m[2] - MISSED_M:
                break
            rests = rests + 1 if rests >= RESTS or abs(height_m - last_m) < REST_M else 0
            pose, last_m = next(path, None) if rests >= RESTS else pose, height_m
        return seen
