"""The blind baseline that looks and approaches but never touches."""

from __future__ import annotations

import logging

import numpy as np

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.errors import ContractError
from carecontact.policies.language.rules import Rules
from carecontact.policies.motion import (
    CONTROL_HZ,
    NEAR_SPEED_M_S,
    TRAVEL_CLEARANCE_M,
    Leg,
    radial_quat,
    sample,
    travel,
)
from carecontact.sight import PerceptionFailure, person_points, region_from_observation

CAMERA = "overhead"
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

    def reset(self, instruction: str) -> None:
        """Read the region and its side, whatever the action is. Raises LanguageError if rules-v1 finds none."""
        self._place = Rules().parse_place(instruction)

    def act(self, observation: Observation) -> list[Action]:
        """Return the whole way as one chunk, of which the last action ends the trial."""
        try:
            poses = list(sample(self.way(observation), observation.pose_tcp_in_base, control_hz=CONTROL_HZ))
        except PerceptionFailure as error:
            logger.warning("Hover stays where it is: %s", error)
            return [Action(done=True)]
        return [Action(pose_tcp_in_base=pose, done=k == len(poses) - 1) for k, pose in enumerate(poses)]

    def way(self, observation: Observation, *, hold_s: float = HOLD_S) -> list[Leg]:
        """Return the way over the region, where it waits for ``hold_s`` [s], and up again.

        Raises PerceptionFailure if the region is not found, ContractError if ``reset`` was not called before.
        """
        if self._place is None:
            raise ContractError("act() was called before reset()")
        region, side = self._place
        geometry = region_from_observation(observation, region, side=side, camera=CAMERA)
        wait = Leg(
            points=(geometry.centre_m + np.array([0.0, 0.0, HEIGHT_M]))[None],
            quat_wxyz=radial_quat(geometry.centre_m),
            speed_m_s=NEAR_SPEED_M_S,
            hold_s=hold_s,
        )
        clear = float(person_points(observation.cameras[CAMERA])[:, 2].max()) + TRAVEL_CLEARANCE_M
        return travel(observation.pose_tcp_in_base, [wait], travel_height_m=clear)
