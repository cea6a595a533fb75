"""The state machine's motions, pressed by force: looks, presses without stiffness along the tool, and looks again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.interface.robot import Session
from carecontact.policies.language.backend import LanguageBackend, Rules
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, NEAR_SPEED_M_S, Leg, sample
from carecontact.policies.pressing import (
    CONTACT,
    FORCE_N,
    HELD_N,
    Felt,
    Motion,
    Part,
    along,
    away,
    end,
    ended,
    held_n,
    softened,
)
from carecontact.policies.state_machine import CAMERA, HOVER_M, StateMachine

F64 = npt.NDArray[np.float64]

SETTLES_S = 0.9
"""Three time constants of the impedance: the tool rests over the skin then, whatever the arm's friction."""
OVER_M = 0.015
"""Height over the seen skin at which the arm becomes soft: more than a seen surface is wrong."""
FEELS_M_S = 0.05
TARES = slice(8, 14)
"""Control periods of a way down, and of the way back, in which the arm's own force is measured: the tool has the speed
of its target then, and what its encoders tell of a force is the arm's. The lowest place is 25 mm over the seen skin."""
WASH_N = 4.0
"""Force [N] of a scrub: near the middle of the 1 to 8 N in which people wash, as the oracle has it."""
LANDS_N = 1.5
"""Force [N] beside friction with which the tool comes down: with half of FORCE_N it does not knock."""
MOST_OWN_N = 3.0
"""Largest bias and friction [N] that are taken for the arm's own; more is a person who was met higher than seen."""
SINKS, RESTS, REST_M = 10, 3, 0.0005
"""Control periods in which a soft arm starts to move, and how many in a row with no more travel than this [m] are a
rest."""
PATIENCE = 80
"""Control periods after which it strokes although the tool does not rest: the person moves."""
MISSED_M = 0.050
"""No skin is so far under the seen skin."""
SLID_M = 0.020
"""A tool that strokes so far below its path, which lies under the seen skin, has slid off the limb."""
MOVED_M = 0.030
"""A person, or foam, that was moved farther is tried again."""
AGAIN_S, LEAVES_S = 11.0, 1.5
"""Time before the trial's end in which another try does not begin, because it presses after 8 s, and in which the tool
leaves the skin, whatever is left to wipe."""


class LookAndPress(StateMachine):
    """Touches and scrubs where the state machine would, with a force in place of a depth; pushes as it does.

    A seen surface is uncertain by 10 mm, and 10 mm of a stiff tool are 4 N. Therefore, over the skin the arm becomes
    soft along the tool, and a feedforward alone moves it: it comes down until the skin carries this force, wherever the
    skin is, and follows a person who breathes. Before, it moves toward the skin and back, and the encoders tell what
    force the arm's own bias and friction take; later, they tell when the tool rests. Then it looks again, and tries
    again if the person was moved, or if foam is left that it was to wash off. Where the encoders tell that something
    holds or pushes the tool, or that it slid off the limb, it lifts off at once, looks, and tries again.
    """

    def __init__(self, *, language: str | LanguageBackend = Rules.name, record: Path | None = None) -> None:
        super().__init__(language=language, record=record)
        # The force leads the tool out of a way that was planned inside of the workspace.
        self.card = replace(self.card, name="look-and-press", camera_hz={CAMERA: 0.0}, out_of_bounds="clip")
        self._limit_s, self._motion = np.inf, None

    def configure(self, session: Session) -> None:
        super().configure(session)
        self._limit_s = session.time_limit_s

    def reset(self, instruction: str) -> None:
        super().reset(instruction)
        self._motion: Motion | None = None
        self._own: tuple[float, float] | None = None

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the next chunk; the last action of the trial ends it."""
        if self._intent is not None and self._intent.action == "push":
            return super().act(observation)
        if self._motion is None:
            self._motion = self._whole(observation)
            return next(self._motion)
        return self._motion.send(observation)

    def _whole(self, seen: Observation) -> Motion:
        home, before, whole = seen.pose_tcp_in_base, np.full(3, np.inf), True
        washes = self._to_foam and self._intent is not None and self._intent.action == "scrub"
        while True:
            try:
                legs = self.choose(seen).legs
            except ContractError as error:
                self._notes["ended_because" if np.isfinite(before).all() else "ended_without_touching"] = str(error)
                break
            place = legs[CONTACT].points[-1]
            if whole and not washes and np.linalg.norm(place - before) < MOVED_M:
                break
            before = place
            whole, seen = yield from self._press(legs, seen)
            up = away(legs, seen.pose_tcp_in_base, NEAR_SPEED_M_S if whole else FREE_SPEED_M_S)
            if seen.sim_time_s > self._limit_s - AGAIN_S:
                yield ended(up)
                return
            seen = yield up
            level = np.array([*home[:2], legs[-1].points[-1][2]])
            seen = yield along([Leg.to(level, home[3:], FREE_SPEED_M_S)], seen.pose_tcp_in_base)
            seen = yield [Action(look=(CAMERA,))]
        yield [Action(done=True)]

    def _press(self, legs: Sequence[Leg], seen: Observation) -> Part[bool]:
        """Move over the skin, feel the arm's own force there, come down, and press. Return whether it finished."""
        over, down, strokes = legs[:CONTACT], legs[CONTACT], legs[CONTACT + 1 : -2]
        above, pose, out = end(over[-1]), end(down), -matrix_from_quat(down.quat_wxyz)[:, 2]
        settles_s = SETTLES_S if self._own is None else 0.0
        seen = yield along([*over[:-1], replace(over[-1], hold_s=settles_s)], seen.pose_tcp_in_base)
        if self._own is None:
            self._own, seen = yield from self._own_force(Felt(seen, above, out), out, seen)
            self._notes |= dict(zip(("arms_bias_n", "arms_friction_n"), np.round(self._own, 2).tolist(), strict=True))
        bias_n, friction_n = self._own
        near = Leg.to(above[:3] - (HOVER_M - OVER_M) * out, above[3:], FEELS_M_S)
        seen = yield along([near], above)
        # A tool that rests after it came down is held back by friction; one that strokes is not.
        pressed_n = WASH_N if strokes else FORCE_N + friction_n
        path, rests, waited, last_m = sample([down, *strokes], pose), -SINKS, 0, np.inf
        while pose is not None and seen.sim_time_s < self._limit_s - LEAVES_S:
            sinks = rests < RESTS and waited < PATIENCE
            force_n, before = bias_n + (LANDS_N + friction_n if sinks else pressed_n), seen.pose_tcp_in_base
            seen = yield [softened(Action(pose_tcp_in_base=pose), force_n)]
            sunk_m = float((pose - seen.pose_tcp_in_base)[:3] @ out)
            if sunk_m > (MISSED_M if sinks else SLID_M) or held_n(seen.pose_tcp_in_base, before, pose) > HELD_N:
                return False, seen
            if sinks:
                rests = rests + 1 if rests < 0 or abs(sunk_m - last_m) < REST_M else 0
                waited, last_m = waited + 1, sunk_m
            else:
                pose = next(path, None)
        return True, seen

    def _own_force(self, felt: Felt, out: F64, seen: Observation) -> Part[tuple[float, float]]:
        """Move toward the skin and back; return the force [N] that cancels the arm's bias, and the arm's friction."""
        means = list[float]()
        for step in (-FEELS_M_S / CONTROL_HZ * out, FEELS_M_S / CONTROL_HZ * out):
            found = list[float]()
            for _ in range(TARES.stop):
                seen = yield felt.go(np.concatenate([felt.target[:3] + step, felt.target[3:]]))
                found.append(felt.newtons(seen))
            means.append(float(np.mean(found[TARES])))
        bias_n, friction_n = (means[0] + means[1]) / 2, (means[0] - means[1]) / 2
        own = np.clip([bias_n, friction_n], [-MOST_OWN_N, 0.0], MOST_OWN_N)
        return (float(own[0]), float(own[1])), seen
