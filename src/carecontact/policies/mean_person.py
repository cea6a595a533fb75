"""Blind baseline: the state machine's motions on the average person, whose places are stored in the overhead camera's
frame."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, ValidationError

from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action import Action
from carecontact.interface.body_view import RegionGeometry
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import ActionBounds, Session
from carecontact.policies.language.backend import Intent, Rules
from carecontact.policies.language.completion import first_fault
from carecontact.policies.motion import CONTROL_HZ, Leg, chunk
from carecontact.policies.state_machine import PlanningFailure, candidates

F64 = npt.NDArray[np.float64]

FILE = "person.json"
"""tools/mean_person.py writes it."""


class MeanRegion(BaseModel):
    """Means over persons; lengths in metres."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    centre_in_camera: tuple[float, float, float]
    axis_in_camera: tuple[float, float, float]
    """Axis from proximal to distal (abdomen: to cranial), of any length."""
    radius_m: float
    half_length_m: float
    profile_m: tuple[tuple[float, float], ...]
    """Distance along the axis from the centre, and height of the skin over the line along the axis."""
    support_under_m: float | None
    """How far the centre is above what the limb lies on."""
    way_over_m: float
    """How far above the centre the robot travels over the person."""


class MeanPerson(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    made_by: str
    protocol: str
    protocol_sha256: str
    seeds: tuple[int, ...]
    """Seeds over which the means were taken."""
    camera: str
    regions: dict[str, MeanRegion]


def read_person(path: Path | None) -> MeanPerson:
    """Return the means in a file, or in one that is shipped beside FILE and is named without its suffix; None: FILE.
    Raises ConfigError for a file that cannot be read."""
    shipped = resources.files("carecontact.policies") / "data" / "mean_person"
    kept = shipped / (FILE if path is None else f"{path}.json")
    try:
        return MeanPerson.model_validate_json((kept if path is None or kept.is_file() else path).read_bytes())
    except OSError as error:
        names = sorted(file.name.removesuffix(".json") for file in shipped.iterdir() if file.name.endswith(".json"))
        raise ConfigError(
            f"mean person {path or FILE}: {error.strerror}; valid: {', '.join(names)}, or a file that "
            "tools/mean_person.py wrote"
        ) from None
    except ValidationError as error:
        raise ConfigError(f"mean person {path or FILE}: {first_fault(error, 'the file')}") from None


def geometry_in_base(name: str, mean: MeanRegion, pose_camera_in_base: F64) -> RegionGeometry:
    """Return the region as it would lie under a camera (4, 4) that stands elsewhere."""
    turn = pose_camera_in_base[:3, :3]
    centre: F64 = turn @ np.array(mean.centre_in_camera) + pose_camera_in_base[:3, 3]
    axis: F64 = turn @ np.array(mean.axis_in_camera)
    axis /= np.linalg.norm(axis)
    lateral = np.array([-axis[1], axis[0], 0.0]) / np.hypot(axis[0], axis[1])
    return RegionGeometry(
        region=name,
        centre_m=centre,
        axis=axis,
        normal=np.cross(axis, lateral).astype(np.float64),
        lateral=lateral,
        radius_m=mean.radius_m,
        half_length_m=mean.half_length_m,
        profile_m=np.array(mean.profile_m),
        support_height_m=None if mean.support_under_m is None else float(centre[2]) - mean.support_under_m,
    )


logger = logging.getLogger(__name__)


class MeanPersonPolicy:
    """Reads the instruction, takes the region where persons have it on average, and acts as the state machine does.

    It receives the overhead camera's pose and no picture. If the arm does not reach the region there, it ends the trial
    and logs the reason.
    """

    name = "mean-person"

    def __init__(self, *, person: Path | None = None) -> None:
        """``person``: file of tools/mean_person.py; default: the shipped one. Raises ConfigError."""
        self._person = read_person(person)
        self._rules = Rules()
        self.card = PolicyCard(
            name=self.name, cameras=(self._person.camera,), control_hz=CONTROL_HZ, language_backend=Rules.name
        )
        self._bounds: ActionBounds | None = None
        self._intent: Intent | None = None

    def configure(self, session: Session) -> None:
        self._bounds = session.action_bounds

    def reset(self, instruction: str) -> None:
        """Read the instruction. Raises LanguageError if the rules do not understand it."""
        self._intent = self._rules.parse(instruction)

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the whole plan as one chunk, of which the last action ends the trial."""
        if self._intent is None:
            raise ContractError("act() was called before reset()")
        try:
            return self._begin(self._intent, observation)
        except ContractError as error:
            logger.warning("The mean person's policy ends the trial without touching: %s", error)
            return [Action(done=True)]

    def _begin(self, intent: Intent, observation: Observation) -> Sequence[Action]:
        """Return the first chunk of a trial. Raises PlanningFailure."""
        return chunk(self._planned(intent, observation)[1], observation.pose_tcp_in_base)

    def _planned(self, intent: Intent, observation: Observation) -> tuple[RegionGeometry, list[Leg]]:
        """Return where the mean person has the region, and the state machine's way over it and back.

        Raises PlanningFailure if nothing is known of the region, or the arm does not reach it.
        """
        mean = self._person.regions.get(intent.region)
        if mean is None:
            raise PlanningFailure(f"nothing is known of the {intent.region} of the mean person")
        pose, start = observation.cameras[self._person.camera].pose_camera_in_base, observation.pose_tcp_in_base
        geometry = geometry_in_base(intent.region, mean, pose)
        height = float(geometry.centre_m[2]) + mean.way_over_m
        options = candidates(geometry, start_pose=start, travel_height_m=height, bounds=self._bounds)
        return geometry, options[self._rules.choose(intent, [option.option for option in options])].legs
