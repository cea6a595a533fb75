"""The simplest baselines: parked, random targets, hovering over the region, and a feint before a method acts."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pkgutil import resolve_name
from typing import Any

import numpy as np

from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action import Action
from carecontact.interface.body_view import PerceptionFailure, person_points, region_from_observation
from carecontact.interface.observation import MODALITIES, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.policies.language.backend import Rules
from carecontact.policies.motion import (
    CONTROL_HZ,
    FREE_SPEED_M_S,
    NEAR_SPEED_M_S,
    TRAVEL_CLEARANCE_M,
    UP,
    Leg,
    chunk,
    radial_quat,
    sample,
    travel,
)
from carecontact.policies.registry import POLICIES


class ZeroAction:
    """Keeps the parked pose, sees nothing and never ends a trial, so that every trial runs to its time limit."""

    card = PolicyCard(name="zero-action", cameras=(), control_hz=1.0)

    def reset(self, instruction: str) -> None:
        """Ignore the instruction."""

    def act(self, observation: Observation) -> list[Action]:
        return [Action()] * 30  # At 1 Hz, half a minute, which is a usual trial.


CAMERA = "overhead"
NEW_TARGET_S = 1.0
"""Time between two targets: at the session's speed limit, the tool moves about 0.25 m."""
POINTING_DOWN = np.array([0.0, 1.0, 0.0, 0.0])


class RandomTargets:
    """Moves to a new target every NEW_TARGET_S until time is up: uniform over the workspace, the tool pointing down.

    The instruction and the first depth image seed the random numbers: no other input differs between trials.
    """

    card = PolicyCard(name="random", modalities=("depth",), cameras=(CAMERA,), control_hz=1.0 / NEW_TARGET_S)

    def __init__(self) -> None:
        self._session: Session | None = None
        self._instruction = ""

    def configure(self, session: Session) -> None:
        self._session = session

    def reset(self, instruction: str) -> None:
        self._instruction = instruction

    def act(self, observation: Observation) -> list[Action]:
        """Return the targets of the whole trial as one chunk. Raises ContractError without a session or depth image."""
        depth = observation.cameras[CAMERA].depth
        if self._session is None or depth is None:
            raise ContractError(f"act() needs a session from configure() and the depth image of camera {CAMERA}")
        digest = hashlib.sha256(self._instruction.encode() + depth.tobytes()).digest()
        rng = np.random.default_rng(np.frombuffer(digest, np.uint32))
        bounds = self._session.action_bounds
        count = int(np.ceil(self._session.time_limit_s / NEW_TARGET_S))
        targets = rng.uniform(bounds.workspace_low_m, bounds.workspace_high_m, (count, 3))
        return [Action(pose_tcp_in_base=np.concatenate([target, POINTING_DOWN])) for target in targets]


HEIGHT_M = 0.05
"""Height above the seen surface: five times the error of that surface, so that a contact is an error of perception."""
HOLD_S = 5.0
"""Longer than any contact that a task requires, so that the touch is missing and not the time."""

logger = logging.getLogger(__name__)


class Hover:
    """Finds the named region as the state machine does, waits HEIGHT_M above it for HOLD_S, leaves, and ends the trial.

    If it cannot find the region, it ends the trial where it stands and logs the reason.
    """

    card = PolicyCard(
        name="hover",
        modalities=("depth", "points", "masks", "landmarks"),
        cameras=(CAMERA,),
        control_hz=CONTROL_HZ,
        language_backend=Rules.name,
    )

    def __init__(self) -> None:
        self._place: tuple[str, str] | None = None
        self._highest_m = np.inf

    def configure(self, session: Session) -> None:
        self._highest_m = session.action_bounds.workspace_high_m[2]

    def reset(self, instruction: str) -> None:
        """Read the region and its side, whatever the action is. Raises LanguageError if rules-v1 finds none."""
        self._place = Rules().parse_place(instruction)

    def act(self, observation: Observation) -> list[Action]:
        """Return the whole way as one chunk, of which the last action ends the trial."""
        try:
            return chunk(self.way(observation), observation.pose_tcp_in_base)
        except PerceptionFailure as error:
            logger.warning("Hover stays where it is: %s", error)
            return [Action(done=True)]

    def way(self, observation: Observation, *, hold_s: float = HOLD_S) -> list[Leg]:
        """Return the way over the region, where it waits for ``hold_s`` [s], and up. Raises PerceptionFailure."""
        if self._place is None:
            raise ContractError("act() was called before reset()")
        region, side = self._place
        geometry = region_from_observation(observation, region, side=side, camera=CAMERA)
        over = geometry.centre_m + HEIGHT_M * UP
        wait = Leg.to(over, radial_quat(geometry.centre_m), NEAR_SPEED_M_S, hold_s=hold_s)
        clear = float(person_points(observation.cameras[CAMERA])[:, 2].max()) + TRAVEL_CLEARANCE_M
        return travel(observation.pose_tcp_in_base, [wait], travel_height_m=min(clear, self._highest_m))


OVER_S, WAIT_S = 2.0, 3.0
"""Above the region and, back where the robot was parked, before the policy is asked: a trigger on an approach, or one
early movement of the person, has passed by then. The policy is left with some 17 s of a
trial of 30 s, which is too short for long scrubs."""


class FeintAndWait:
    """Moves over the region as ``hover`` does, goes back, waits, and only then shows the policy what it sees.

    A world in which the person moves must not reward this: a person who moves at a fixed time, or when the robot comes
    near, can be provoked and waited for.
    """

    def __init__(self, *, base: str = "state-machine") -> None:
        """``base``: name of the registered policy that acts afterwards. Raises ConfigError for one that cannot."""
        self._base, self._hover = _policy(base), Hover()
        card = self._base.card
        wanted = {*card.modalities, *Hover.card.modalities}
        modalities = tuple(name for name in MODALITIES if name in wanted)
        cameras = tuple(dict.fromkeys((*card.cameras, *Hover.card.cameras)))
        self.card = replace(card, name="feint-and-wait", modalities=modalities, cameras=cameras)
        self._began = False

    def configure(self, session: Session) -> None:
        for policy in (self._hover, self._base):
            if hasattr(policy, "configure"):
                policy.configure(session)

    def reset(self, instruction: str) -> None:
        self._began = False
        self._hover.reset(instruction)
        self._base.reset(instruction)

    def act(self, observation: Observation) -> Action | Sequence[Action]:
        """Return the feint at first, then the answers of the policy. Without a person in view, it only waits."""
        if self._began:
            return self._base.act(observation)
        self._began = True
        start = observation.pose_tcp_in_base
        legs: list[Leg] = []
        with suppress(PerceptionFailure):
            legs = [*self._hover.way(observation, hold_s=OVER_S), Leg.to(start[:3], start[3:], FREE_SPEED_M_S)]
        feint = [Action(pose_tcp_in_base=pose) for pose in sample(legs, start)]
        return [*feint, *[Action()] * round(WAIT_S * CONTROL_HZ)]

    def take_notes(self) -> dict[str, object]:
        return self._base.take_notes() if self._began and hasattr(self._base, "take_notes") else {}


def _policy(name: str) -> Any:
    usable = [n for n, row in POLICIES.usable().items() if row.role != "privileged" and n != "feint-and-wait"]
    if name not in usable:
        raise ConfigError(f"base: no policy {name!r} that could act after a feint; valid: {', '.join(usable)}")
    base = resolve_name(POLICIES[name].target)()
    if base.card.control_hz != CONTROL_HZ or base.card.action_space != "cartesian_pose":
        raise ConfigError(
            f"base: {name} does not send poses of the tool at {CONTROL_HZ:g} Hz, at which the feint moves"
        )
    return base
