"""Look, touch with a constant force, look again. From this folder:

    carecontact run --policy look_and_press:Press --protocol bathing-v3 --tasks T1

It presses the middle of the region. In the exam, a touch has to meet the foam, and this policy does not look for it.

The overhead camera takes a picture when the policy asks for one; the robot's encoders come at 20 Hz without asking. A
picture tells where the skin is to about 10 mm, and 10 mm more or less of a stiff tool are 4 N. Therefore, the tool goes
to a place above the skin, and from there nothing but a feedforward of 3 N moves it along its own axis: it comes down
until the skin carries these 3 N, wherever the skin is, and follows a person who breathes. Its encoders say when it
rests, and when the person pushes or holds it: then it lifts off. The shipped policy `look-and-press` adds scrubs,
pushes, foam, room for the hand, and a measurement of the arm's own bias and friction.
"""

import numpy as np

from carecontact.interface.action import Action
from carecontact.interface.body_view import PerceptionFailure, person_points, region_from_observation
from carecontact.interface.policy import PolicyCard
from carecontact.policies.language.backend import Rules
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, UP, Leg, radial_quat, sample, travel
from carecontact.policies.pressing import FORCE_N, HELD_N, held_n, softened
from carecontact.policies.state_machine import travel_height

OVER_M, STAYS = 0.03, 40  # height over the skin at which the arm becomes soft; control periods of 3 N
RESTS, REST_M = 3, 0.0005  # so many periods in a row with no more travel than this are a rest
MISSED_M, MOVED_M = 0.05, 0.03  # no person is so far under the seen skin; a person who moved farther is tried again


class Press:
    card = PolicyCard(
        name="press", modalities=("depth", "points", "masks", "landmarks"), cameras=("overhead",),
        control_hz=CONTROL_HZ, camera_hz={"overhead": 0},
    )  # fmt: skip

    def reset(self, instruction):
        self._intent, self._motion = Rules().parse(instruction), None

    def act(self, observation):
        """Return the next action of a motion that is written as if it ran by itself, and waits at each ``yield``."""
        if self._motion is None:
            self._motion = self._whole(observation)
            return next(self._motion)
        return self._motion.send(observation)

    def _whole(self, seen):
        home, before = seen.pose_tcp_in_base, np.full(3, np.inf)
        for _ in range(3):
            try:
                skin = region_from_observation(seen, self._intent.region, side=self._intent.side).centre_m
            except PerceptionFailure:
                break
            if np.linalg.norm(skin - before) < MOVED_M:
                break
            before, height = skin, travel_height(person_points(seen.cameras["overhead"]), home, skin)
            over = Leg.to(skin + OVER_M * UP, radial_quat(skin), FREE_SPEED_M_S, hold_s=0.5)
            *there, up = travel(seen.pose_tcp_in_base, [over], travel_height_m=height)
            for pose in sample(there, seen.pose_tcp_in_base):
                seen = yield Action(pose_tcp_in_base=pose)
            rests, stayed, last_m = 0, 0, seen.pose_tcp_in_base[2]
            while stayed < STAYS and last_m > skin[2] - MISSED_M:
                last, seen = seen.pose_tcp_in_base, (yield softened(Action(pose_tcp_in_base=pose), FORCE_N))
                if held_n(seen.pose_tcp_in_base, last, pose) > HELD_N:
                    break
                sunk_m, last_m = last_m - seen.pose_tcp_in_base[2], seen.pose_tcp_in_base[2]
                stayed += rests >= RESTS
                rests = rests + 1 if rests >= RESTS or abs(sunk_m) < REST_M else 0
            back = Leg.to(np.array([*home[:2], height]), home[3:], FREE_SPEED_M_S, hold_s=0.5)
            for pose in sample([up, back], seen.pose_tcp_in_base):
                seen = yield Action(pose_tcp_in_base=pose, stiffness=(400.0, 20.0), wrench_in_tcp=np.zeros(6))
            seen = yield Action(look=("overhead",))
        return (yield Action(done=True))
