"""The state machine as a policy: it takes one observation and returns one open-loop plan."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import MAX_CHUNK, Action
from carecontact.contract.geometry import pixels
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import ActionBounds, Session
from carecontact.errors import ContractError
from carecontact.policies.language.backend import Intent, LanguageBackend
from carecontact.policies.language.model import LanguageModel
from carecontact.policies.language.rules import Rules
from carecontact.policies.language.selection import transcript_of
from carecontact.policies.motion import CONTROL_HZ, sample
from carecontact.policies.state_machine.candidates import Candidate, PlanningFailure, candidates
from carecontact.policies.state_machine.primitives import travel_height
from carecontact.sight import person_points, region_from_observation

F64 = npt.NDArray[np.float64]
CAMERA = "overhead"
logger = logging.getLogger(__name__)


class StateMachine:
    """Looks once with the robot parked, lets a language backend choose a motion, and executes it without looking again.

    If the region cannot be found or reached, it ends the trial without touching and logs the reason.
    """

    def __init__(self, *, language: str | LanguageBackend = Rules.name, record: Path | None = None) -> None:
        """
        Args:
            language: rules-v1, replay:FILE.jsonl, live:MODEL, or the backend itself, which reads the instruction and
                chooses.
            record: file to which the completions of a live model are added.

        Raises ConfigError for a language that cannot be read, DependencyError for live without its package.
        """
        self._language = _backend(language, record) if isinstance(language, str) else language
        self.card = PolicyCard(
            name="state-machine",
            modalities=("rgb", "depth", "points", "masks", "landmarks"),
            cameras=(CAMERA,),
            control_hz=CONTROL_HZ,
            language_backend=self._language.name,
        )
        self._bounds: ActionBounds | None = None
        self._intent: Intent | None = None
        self._notes: dict[str, object] = {}

    def configure(self, session: Session) -> None:
        """Take over the workspace bounds. Without this call the workspace counts as unlimited."""
        self._bounds = session.action_bounds

    def reset(self, instruction: str) -> None:
        """Read the instruction. Raises LanguageError if the backend does not understand it."""
        self._intent, self._notes = None, {}
        self._intent = self._language.parse(instruction)

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the whole plan as one chunk of at most MAX_CHUNK actions, of which the last one ends the trial."""
        try:
            chosen = self.choose(observation)
            poses = list(sample(chosen.legs, observation.pose_tcp_in_base, control_hz=CONTROL_HZ))
            if len(poses) > MAX_CHUNK:
                raise PlanningFailure(f"the plan has {len(poses)} actions; a chunk holds at most {MAX_CHUNK}")
        except ContractError as error:
            logger.warning("The state machine ends the trial without touching: %s", error)
            self._notes["ended_without_touching"] = str(error)
            return [Action(done=True)]
        return [Action(pose_tcp_in_base=pose, done=k == len(poses) - 1) for k, pose in enumerate(poses)]

    def choose(self, observation: Observation) -> Candidate:
        """Return the motion that the language backend chooses for what is seen.

        Raises:
            PerceptionFailure: the region is not found in the observation.
            PlanningFailure: the arm reaches no place of the region.
            ContractError: ``reset`` was not called before.
        """
        intent = self._intent
        if intent is None:
            raise ContractError("act() was called before reset()")
        side = "right" if intent.side == "none" else intent.side
        geometry = region_from_observation(observation, intent.region, side=side, camera=CAMERA)
        height = travel_height(
            person_points(observation.cameras[CAMERA]), observation.pose_tcp_in_base, geometry.centre_m
        )
        options = candidates(
            geometry, start_pose=observation.pose_tcp_in_base, travel_height_m=height, bounds=self._bounds
        )
        view = observation.cameras[CAMERA]
        self._notes |= {"method": self.card.name, "camera": CAMERA, "intent": intent.model_dump()}
        self._notes["options"] = [
            asdict(candidate.option)
            | {
                "corners_m": candidate.corners_m.round(4).tolist(),
                "corners_px": pixels(candidate.corners_m, view.intrinsics, view.pose_camera_in_base).round(1).tolist(),
            }
            for candidate in options
        ]
        index = self._language.choose(intent, [option.option for option in options])
        self._notes["chosen"] = index
        logger.info("The state machine chose %s of %d options", options[index].option, len(options))
        return options[index]

    def take_notes(self) -> dict[str, object]:
        """Return the options with their places in the picture, the choice, and the calls to a language model."""
        calls, notes = self._language.take_calls(), self._notes
        self._notes = {}
        return notes | ({"language": calls} if calls else {})


def _backend(language: str, record: Path | None) -> LanguageBackend:
    transcript = transcript_of(language, record=record)
    return Rules() if transcript is None else LanguageModel(transcript)
