"""The null arm that looks and approaches but never touches."""

from __future__ import annotations

import logging

import numpy as np

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.errors import ContractError
from carecontact.policies.language.backend import Intent
from carecontact.policies.language.rules import Rules
from carecontact.policies.region_geometry import person_points, region_from_observation
from carecontact.policies.state_machine import fixed_values as fixed
from carecontact.policies.state_machine.primitives import Leg, radial_quat, sample, travel

CAMERA = "overhead"
HEIGHT_M = 0.05
"""Above the surface that is seen: five times its error, so that a contact here is an error of the perception."""
HOLD_S = 5.0
"""Longer than any contact that a task asks for: what is missing is touch, not time."""

logger = logging.getLogger(__name__)


class Hover:
    """Finds the named region as the state machine does, waits HEIGHT_M above it for HOLD_S, leaves and is done.

    If the region cannot be found it ends the trial where it stands, and logs why.
    """

    card = PolicyCard(
        name="hover",
        modalities=("depth", "points", "masks", "landmarks"),
        cameras=(CAMERA,),
        control_hz=fixed.CONTROL_HZ,
        language_backend=Rules.name,
    )

    def __init__(self) -> None:
        self._intent: Intent | None = None

    def reset(self, instruction: str) -> None:
        """Raises LanguageError if rules-v1 does not understand the instruction."""
        self._intent = Rules().parse(instruction)

    def act(self, observation: Observation) -> list[Action]:
        """The whole way as one chunk, the last action of it done."""
        if self._intent is None:
            raise ContractError("act() before reset()")
        side = "right" if self._intent.side == "none" else self._intent.side
        try:
            geometry = region_from_observation(observation, self._intent.region, side=side, camera=CAMERA)
        except ContractError as error:
            logger.warning("hover stays where it is: %s", error)
            return [Action(done=True)]
        wait = Leg(
            points=(geometry.centre_m + np.array([0.0, 0.0, HEIGHT_M]))[None],
            quat_wxyz=radial_quat(geometry.centre_m),
            speed_m_s=fixed.NEAR_SPEED_M_S,
            hold_s=HOLD_S,
        )
        clear = float(person_points(observation.cameras[CAMERA])[:, 2].max()) + fixed.TRAVEL_CLEARANCE_M
        legs = travel(observation.pose_tcp_in_base, [wait], travel_height_m=clear)
        poses = list(sample(legs, observation.pose_tcp_in_base, control_hz=fixed.CONTROL_HZ))
        return [Action(pose_tcp_in_base=pose, done=k == len(poses) - 1) for k, pose in enumerate(poses)]
