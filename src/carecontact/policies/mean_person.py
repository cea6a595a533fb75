"""Blind baselines: the state machine's motions on the average person, whose places are stored in the overhead camera's
frame; by depth, by feedforward, by a force that the encoders tell, and after feeling at several places."""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence
from dataclasses import replace
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
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, UP, Leg, chunk, sample
from carecontact.policies.pressing import CONTACT, FORCE_N, Felt, Motion, Part, along, away, end, ended, softened
from carecontact.policies.state_machine import HOVER_M, PlanningFailure, candidates

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

    It receives the overhead camera's pose and no picture. If the arm does not reach the region, it ends the trial.
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


class _Pressing(MeanPersonPolicy):
    """Touches and scrubs where the mean person has the region, with a force; pushes as ``mean-person`` does."""

    def __init__(self, *, person: Path | None = None) -> None:
        super().__init__(person=person)
        # The force leads the tool out of a way that was planned inside of the workspace.
        self.card = replace(self.card, out_of_bounds="clip")
        self._motion: Motion | None = None

    def reset(self, instruction: str) -> None:
        super().reset(instruction)
        self._motion = None

    def act(self, observation: Observation) -> Sequence[Action]:
        return super().act(observation) if self._motion is None else self._motion.send(observation)

    def _begin(self, intent: Intent, observation: Observation) -> Sequence[Action]:
        if intent.action == "push":
            return super()._begin(intent, observation)
        geometry, legs = self._planned(intent, observation)
        self._motion = self._moves(legs, geometry.lateral, observation)
        return next(self._motion)

    def _moves(self, legs: Sequence[Leg], lateral: F64, observation: Observation) -> Motion:
        """Press along the state machine's way; ``lateral``: (3,) level direction across the region."""
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

    def _feel(self, felt: Felt, lowest_m: float, observation: Observation) -> Part[bool]:
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
