"""Blind baselines that press the mean person with a force: by feedforward, by a force that the encoders tell, and after
feeling for the region at several places. None of them receives a picture."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.policies.language.backend import Intent
from carecontact.policies.mean_person import MeanPersonPolicy
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, UP, Leg, sample
from carecontact.policies.pressing import CONTACT, FORCE_N, Felt, Motion, along, away, end, ended, softened
from carecontact.policies.state_machine import HOVER_M

F64 = npt.NDArray[np.float64]


class _Pressing(MeanPersonPolicy):
    """Touches and scrubs where the mean person has the region, with a force; pushes as ``mean-person`` does."""

    def __init__(self, *, person: Path | None = None) -> None:
        """``person``: as ``mean-person`` takes it. Raises ConfigError."""
        super().__init__(person=person)
        # The force leads the tool out of a way that was planned inside of the workspace.
        self.card = replace(self.card, out_of_bounds="clip")
        self._motion: Motion | None = None

    def reset(self, instruction: str) -> None:
        """Read the instruction. Raises LanguageError if the rules do not understand it."""
        super().reset(instruction)
        self._motion = None

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the next chunk; the last action of the trial ends it."""
        return super().act(observation) if self._motion is None else self._motion.send(observation)

    def _begin(self, intent: Intent, observation: Observation) -> Sequence[Action]:
        if intent.action == "push":
            return super()._begin(intent, observation)
        geometry, legs = self._planned(intent, observation)
        self._motion = self._moves(legs, geometry.lateral, observation)
        return next(self._motion)

    def _moves(self, legs: Sequence[Leg], lateral: F64, observation: Observation) -> Motion:
        """Yield the chunks of a trial, and take the observation after each.

        Args:
            legs: the state machine's way.
            lateral: (3,) level direction across the region.
        """
        raise NotImplementedError


# Hybrid: no stiffness along the tool, where a constant force presses.

LANDS_S = 2.0
"""Least wait over the place: with 3 N against the damping of a soft axis, the tool sinks by 47 mm/s, and by a third of
that on an arm with friction and an unlucky bias."""


class MeanPersonHybrid(_Pressing):
    """Presses with a feedforward of FORCE_N along the tool and follows the state machine's path across it."""

    name = "mean-person-hybrid"

    def _moves(self, legs: Sequence[Leg], lateral: F64, observation: Observation) -> Motion:
        down, *rest = legs[CONTACT:-2]
        over = along(legs[:CONTACT], observation.pose_tcp_in_base)
        lands = replace(down, hold_s=max(down.hold_s, LANDS_S))
        first, *presses = along([lands, *rest], end(legs[CONTACT - 1]))
        soft = softened(first, FORCE_N)
        observation = yield [*over, soft, *presses]
        yield ended(away(legs, observation.pose_tcp_in_base))


# Estimated: what the spring and the damper of the impedance do not explain of the tool's place is the person's force.

TOUCHES_N = 1.5
"""Estimated force at which the tool has met something."""
FEELS_M_S = 0.05
TARES = slice(5, 10)
"""Control periods of a descent in which the estimate is set to zero: the tool has the speed of its target then, and the
friction and the bias of the arm show as a force. The tool has come down by 25 mm then, and is still over the skin."""
RESTS_S = 0.9
"""Three time constants of the impedance: what is left of the way there is no force."""
LOWER_M = 0.025
"""How much lower than at first the tool comes down again, to have time for five places."""
LOWEST_M = 0.060
"""How far below the mean skin the tool is moved in search of contact."""
GAIN_M_NS = 0.006
"""Rate of the target's depth for each newton that is missing, as the oracle has it."""
DEEPEST_M = 0.060
"""Largest distance of the target below the tool: 24 N whatever is estimated."""
SETTLES_S = 1.0
"""Time that the force is given to settle, twice the time constant of the loop, before the state machine's own rest."""


class MeanPersonEstimated(_Pressing):
    """Comes down until the encoders tell of a contact, and then keeps the estimated force at FORCE_N along the path."""

    name = "mean-person-estimated"
    offsets_m: tuple[float, ...] = (0.0,)
    """Where it comes down, across the region; the first place where something is met is taken."""
    lowest_m = LOWEST_M

    def _moves(self, legs: Sequence[Leg], lateral: F64, observation: Observation) -> Motion:
        over, down = end(legs[CONTACT - 1]), legs[CONTACT]
        skin_m = float(over[2]) - HOVER_M
        way, at = list(legs[: CONTACT - 1]), observation.pose_tcp_in_base
        for offset in self.offsets_m:
            shift = offset * lateral
            above = np.concatenate([over[:3] + shift, over[3:]])
            above[2] -= LOWER_M if offset else 0.0
            way.append(Leg.to(above[:3], above[3:], FREE_SPEED_M_S, hold_s=RESTS_S))
            observation = yield along(way, at)
            felt = Felt(observation, above)
            met, observation = yield from self._feel(felt, skin_m - self.lowest_m, observation)
            if met:
                observation = yield from self._press(felt, self._path(legs, end(down), shift), observation)
                break
            at = felt.target
            way = [Leg.to(np.array([*at[:2], over[2] - LOWER_M]), over[3:], FREE_SPEED_M_S)]
        yield ended(away(legs, observation.pose_tcp_in_base))

    def _feel(
        self, felt: Felt, lowest_m: float, observation: Observation
    ) -> Generator[Sequence[Action], Observation, tuple[bool, Observation]]:
        """Move straight down until something is met; return whether it was."""
        found = list[float]()
        while felt.target[2] > lowest_m:
            pose = felt.target.copy()
            pose[2] -= FEELS_M_S / CONTROL_HZ
            observation = yield felt.go(pose)
            found.append(felt.newtons(observation))
            if len(found) == TARES.stop:
                felt.zero_n = float(np.mean(found[TARES]))
            # One reading may be noise of the encoders; a contact lasts.
            elif len(found) > TARES.stop + 1 and min(found[-2:]) > TOUCHES_N:
                return True, observation
        return False, observation

    def _path(self, legs: Sequence[Leg], start: F64, shift: F64) -> list[F64]:
        """Return the poses (7,) of the way in contact, a little below the mean skin."""
        rest = Leg.to(start[:3], start[3:], FEELS_M_S, hold_s=SETTLES_S + legs[CONTACT].hold_s)
        poses = sample([rest, *legs[CONTACT + 1 : -2]], start)
        return [np.concatenate([pose[:3] + shift, pose[3:]]) for pose in poses]

    def _press(
        self, felt: Felt, path: Sequence[F64], observation: Observation
    ) -> Generator[Sequence[Action], Observation, Observation]:
        """Follow a path across the skin, at the height at which the force is right."""
        height = float(felt.target[2] - path[0][2])
        for pose in path:
            force = felt.newtons(observation)
            height -= GAIN_M_NS * (FORCE_N - force) / CONTROL_HZ
            height = max(height, float(observation.pose_tcp_in_base[2] - pose[2]) - DEEPEST_M)
            observation = yield felt.go(np.concatenate([pose[:3] + height * UP, pose[3:]]))
        return observation


class MeanPersonSearch(MeanPersonEstimated):
    """Feels for the region at five places across it, and takes the first where something lies as high as the mean
    person's skin, which the board beside a limb does not."""

    name = "mean-person-search"
    offsets_m = (0.0, 0.04, -0.04, 0.08, -0.08)
    lowest_m = 0.050
