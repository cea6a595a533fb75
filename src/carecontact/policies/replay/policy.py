"""The blind baselines that repeat the actions of another trial: a gate that they meet does not require vision."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.errors import ContractError
from carecontact.policies.replay.donor import CONTROL_HZ, Donor, donor_of, read_donors

CAMERA = "overhead"


class Replay:
    """Repeats the actions that were recorded for the same instruction, as the robot's base saw them."""

    card = PolicyCard(name="replay", cameras=(), control_hz=CONTROL_HZ)

    def __init__(self, *, donor: Path | None = None) -> None:
        """``donor``: file of tools/record_replay.py, or the name of a shipped one. Raises ConfigError."""
        self._donors, self._donor = read_donors(donor), None

    def reset(self, instruction: str) -> None:
        """Choose the recording. Raises ContractError for an instruction that was not recorded."""
        self._donor: Donor | None = donor_of(self._donors, instruction, self.card.name)

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return all recorded actions as one chunk, of which the last one ends the trial."""
        return self._placed(observation).chunk()

    def _placed(self, observation: Observation) -> Donor:
        if self._donor is None:
            raise ContractError("act() was called before reset()")
        return self._donor


class ReplayRegistered(Replay):
    """The same as the overhead camera saw them: where robot or camera stand elsewhere, the actions move with it.

    It receives the camera's pose and no picture. A target that would lie outside the workspace is clipped.
    """

    card = PolicyCard(name="replay-registered", cameras=(CAMERA,), control_hz=CONTROL_HZ, out_of_bounds="clip")

    def _placed(self, observation: Observation) -> Donor:
        return super()._placed(observation).seen_from(observation.cameras[CAMERA].pose_camera_in_base)
