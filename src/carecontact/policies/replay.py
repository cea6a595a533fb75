"""Blind baseline: repeats recorded actions of one policy in one trial of each task, without looking."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError, ContractError, LanguageError
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat, quat_from_matrix
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.policies.language.backend import Rules

F64 = npt.NDArray[np.float64]

CONTROL_HZ = 20.0
"""Rate at which the actions were recorded [Hz]."""
ACTIONS = "actions.npz"
"""The shipped file. Such a file has two arrays for each instruction: ``<instruction>``, (n, 9) actions, which are the
pose of the tool in base (7), translational stiffness [N/m] and rotational stiffness [N m/rad], NaN where an action kept
the last value; and ``<instruction>/camera``, (4, 4) pose of the overhead camera in base. tools/record_replay.py writes
it."""
CAMERA_ARRAY = "/camera"


@dataclass(frozen=True, kw_only=True)
class Donor:
    actions: F64
    """(n, 9), see ACTIONS."""
    pose_camera_in_base: F64
    """(4, 4)"""

    def seen_from(self, pose_camera_in_base: F64) -> Donor:
        """Return the path that looks the same in the picture of a camera (4, 4) that stands elsewhere in base."""
        moved = pose_camera_in_base @ np.linalg.inv(self.pose_camera_in_base)
        actions = self.actions.copy()
        for row in actions:
            if np.isnan(row[0]):
                continue
            row[:3] = moved[:3, :3] @ row[:3] + moved[:3, 3]
            row[3:7] = quat_from_matrix(moved[:3, :3] @ matrix_from_quat(_unit(row[3:7])))
        return Donor(actions=actions, pose_camera_in_base=pose_camera_in_base)

    def chunk(self) -> Sequence[Action]:
        """Return all recorded actions; the last one ends the trial."""
        actions: list[Action] = []
        for k, row in enumerate(self.actions):
            pose = None if np.isnan(row[0]) else np.concatenate([row[:3], _unit(row[3:7])])
            stiffness = None if np.isnan(row[7]) else (float(row[7]), float(row[8]))
            actions.append(Action(pose_tcp_in_base=pose, stiffness=stiffness, done=k == len(self.actions) - 1))
        return actions


def _unit(quat: F64) -> F64:
    # The file stores single precision, in which the quaternion's norm is not 1 to the last bit of a double.
    return quat / np.linalg.norm(quat)


def read_donors(path: Path | None = None) -> dict[str, Donor]:
    """Return instruction -> its recorded trial. Raises ConfigError for a file that is none.

    ``path``: a file, or the name of one that is shipped beside ACTIONS, without its suffix; None: ACTIONS.
    """
    kept = resources.files("carecontact.policies") / "data" / "replay" / (ACTIONS if path is None else f"{path}.npz")
    try:
        data = (kept if path is None or kept.is_file() else path).read_bytes()
        with np.load(io.BytesIO(data)) as arrays:
            held = {name: arrays[name].astype(np.float64) for name in arrays.files}
        return {
            name: Donor(actions=rows, pose_camera_in_base=held[name + CAMERA_ARRAY])
            for name, rows in held.items()
            if not name.endswith(CAMERA_ARRAY)
        }
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise ConfigError(f"donor {path}: not a file of tools/record_replay.py ({error!r})") from None


CAMERA = "overhead"


class Replay:
    """Repeats the actions that were recorded for the same instruction, as the robot's base saw them.

    An instruction that was not recorded gets the actions of the one that ``rules-v1`` understands in the same way:
    those of "gently scrub the abdomen" for "gently scrub the foam off the abdomen".
    """

    card = PolicyCard(name="replay", cameras=(), control_hz=CONTROL_HZ)

    def __init__(self, *, donor: Path | None = None) -> None:
        """``donor``: file of tools/record_replay.py, or the name of a shipped one. Raises ConfigError."""
        self._donors = read_donors(donor)

    def reset(self, instruction: str) -> None:
        """Choose the recording. Raises ContractError for an instruction that is like none that was recorded."""
        if (name := self._alike(instruction)) is None:
            valid = ", ".join(sorted(self._donors))
            raise ContractError(f"{self.card.name} has no actions for the instruction {instruction!r}; valid: {valid}")
        self._donor = self._donors[name]

    def _alike(self, instruction: str) -> str | None:
        if instruction in self._donors:
            return instruction
        rules = Rules()
        with suppress(LanguageError):
            wanted = rules.parse(instruction)
            return next((name for name in sorted(self._donors) if rules.parse(name) == wanted), None)
        return None

    def act(self, observation: Observation) -> Sequence[Action]:
        return self._donor.chunk()


class ReplayRegistered(Replay):
    """The same as the overhead camera saw them: where robot or camera stand elsewhere, the actions move with it.

    It receives the camera's pose and no picture. A target that would lie outside the workspace is clipped.
    """

    card = PolicyCard(name="replay-registered", cameras=(CAMERA,), control_hz=CONTROL_HZ, out_of_bounds="clip")

    def act(self, observation: Observation) -> Sequence[Action]:
        return self._donor.seen_from(observation.cameras[CAMERA].pose_camera_in_base).chunk()
