"""The state machine's primitives on the mean person: a gate that this baseline meets does not require vision."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import ActionBounds, Session
from carecontact.errors import ContractError
from carecontact.policies.language.backend import Intent
from carecontact.policies.language.rules import Rules
from carecontact.policies.mean_person.person import geometry_in_base, read_person
from carecontact.policies.motion import CONTROL_HZ, sample
from carecontact.policies.state_machine.candidates import PlanningFailure, candidates

F64 = npt.NDArray[np.float64]
logger = logging.getLogger(__name__)


class MeanPersonPolicy:
    """Reads the instruction, takes the region where persons have it on average, and acts as the state machine does.

    It receives the overhead camera's pose and no picture. If the arm does not reach the region there, it ends the trial
    and logs the reason.
    """

    def __init__(self, *, person: Path | None = None) -> None:
        """``person``: file of tools/mean_person.py; default: the shipped one. Raises ConfigError."""
        self._person = read_person(person)
        self._rules = Rules()
        self.card = PolicyCard(
            name="mean-person", cameras=(self._person.camera,), control_hz=CONTROL_HZ, language_backend=Rules.name
        )
        self._bounds: ActionBounds | None = None
        self._intent: Intent | None = None

    def configure(self, session: Session) -> None:
        """Take over the workspace bounds."""
        self._bounds = session.action_bounds

    def reset(self, instruction: str) -> None:
        """Read the instruction. Raises LanguageError if the rules do not understand it."""
        self._intent = self._rules.parse(instruction)

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the whole plan as one chunk, of which the last action ends the trial."""
        if self._intent is None:
            raise ContractError("act() was called before reset()")
        try:
            poses = list(self._plan(self._intent, observation))
        except PlanningFailure as error:
            logger.warning("The mean person's policy ends the trial without touching: %s", error)
            return [Action(done=True)]
        return [Action(pose_tcp_in_base=pose, done=k == len(poses) - 1) for k, pose in enumerate(poses)]

    def _plan(self, intent: Intent, observation: Observation) -> Iterator[F64]:
        mean = self._person.regions.get(intent.region)
        if mean is None:
            raise PlanningFailure(f"nothing is known of the {intent.region} of the mean person")
        pose = observation.cameras[self._person.camera].pose_camera_in_base
        geometry = geometry_in_base(intent.region, mean, pose)
        start = observation.pose_tcp_in_base
        options = candidates(
            geometry, start_pose=start, travel_height_m=float(geometry.centre_m[2]) + mean.way_over_m,
            bounds=self._bounds,
        )  # fmt: skip
        try:
            chosen = options[self._rules.choose(intent, [option.option for option in options])]
        except ContractError as error:
            raise PlanningFailure(str(error)) from None
        return sample(chosen.legs, start, control_hz=CONTROL_HZ)
