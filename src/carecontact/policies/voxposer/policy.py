"""VoxPoser as a policy: it requests programs once, then looks, composes maps, plans, moves a little, and repeats."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ConfigError, ContractError, ProgramError
from carecontact.policies.language.selection import transcript_of
from carecontact.policies.language.transcript import Transcript
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.composers import HOME, Composers
from carecontact.policies.voxposer.execution import EXECUTE, Execution, arguments, map_queries
from carecontact.policies.voxposer.executor import Motion
from carecontact.policies.voxposer.following import next_stretch
from carecontact.policies.voxposer.functions import MapFunctions
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.lmp import Programs
from carecontact.policies.voxposer.prompts import VOXPOSER, PromptSet
from carecontact.policies.voxposer.roles import Roles
from carecontact.policies.voxposer.sandbox import Sandbox
from carecontact.policies.voxposer.scene import Scene
from carecontact.sight import PerceptionFailure

F64 = npt.NDArray[np.float64]
CAMERA = "overhead"
logger = logging.getLogger(__name__)


class VoxPoser:
    """Follows value maps from programs that a language model wrote; see docs/voxposer.md.

    If it cannot find a part that a program requests, it ends the trial where it stands and logs the reason. A program
    that is stopped or wrong raises ProgramError, and a language backend that fails raises LanguageError; in both
    cases, the trial counts as a process failure of the method.
    """

    name = "voxposer"
    prompts: PromptSet = VOXPOSER
    authored = "authored.jsonl"
    execute = EXECUTE
    """How a program calls ``execute``."""
    horizon_s = fixed.HORIZON_S
    settle_s = fixed.SETTLE_S

    def __init__(self, *, language: str | Transcript | None = None, record: Path | None = None) -> None:
        """
        Args:
            language: replay:FILE.jsonl, live:MODEL, or the transcript itself, which answers the prompts; by default the
                shipped completions that were written by hand.
            record: file to which the completions of a live model are added.

        Raises ConfigError for rules-v1 or a language that cannot be read, DependencyError for live without its package.
        """
        if not isinstance(language, Transcript):
            shipped = resources.files(__package__ or __name__) / "completions" / self.authored
            language = _transcript(language or f"replay:{shipped}", record)
        self._transcript = language
        self.card = PolicyCard(
            name=self.name,
            modalities=("rgb", "depth", "points", "masks", "landmarks"),
            cameras=(CAMERA,),
            control_hz=fixed.CONTROL_HZ,
            language_backend=self._transcript.name,
        )
        self._programs = Programs(self._transcript, self.prompts)
        self._sandbox: Sandbox | None = None
        self._grid: Grid | None = None

    def configure(self, session: Session) -> None:
        """Lay the grid of voxels over the session's workspace."""
        bounds = session.action_bounds
        self._grid = Grid(low_m=np.array(bounds.workspace_low_m), high_m=np.array(bounds.workspace_high_m))

    def reset(self, instruction: str) -> None:
        """Ask the planner for the subtasks, so that a language backend that fails does so before anything moves."""
        if self._grid is None:
            raise ContractError("reset() was called before configure(): the workspace is not known")
        self._scene = Scene(CAMERA, self._grid)
        self._sandbox = self._sandbox or Sandbox()
        self._sandbox.time.start_over()
        self._roles = Roles(self._programs, self._sandbox, MapFunctions(self._scene, self._grid))
        self._notes: dict[str, object] = {"method": self.name, "camera": CAMERA}
        self._home: F64 | None = None
        self._current: Execution | None = None
        subtasks = self._roles.subtasks(instruction)
        self._notes["subtasks"] = subtasks
        self._composers = Composers(self._sandbox, self._roles, subtasks, self._composer_functions())

    def act(self, observation: Observation) -> Sequence[Action]:
        """Return the actions until the next look: at most ``horizon_s``, and ``settle_s`` more at the end of a path."""
        if self._sandbox is None:
            raise ContractError("act() was called before reset()")
        self._sandbox.time.start_over()
        self._scene.look(observation)
        try:
            if self._home is None:
                self._home = observation.pose_tcp_in_base.copy()
                self._composers.rehearse(self._try_execute)
            return self._next_actions()
        except PerceptionFailure as error:
            logger.warning("%s ends the trial where it stands: %s", self.name, error)
            self._notes["ended_because"] = str(error)
            return [Action(done=True)]

    def take_notes(self) -> dict[str, object]:
        """Return the programs, then for every plan its path, and for the first plan of a motion slices of its maps."""
        calls, notes = self._programs.take_calls(), self._notes
        if calls:
            notes |= {"language": calls, "programs": self._programs.written}
        self._notes = {"method": self.name, "camera": CAMERA}
        return notes if len(notes) > 2 else {}

    def _next_actions(self) -> Sequence[Action]:
        while True:
            if self._current is None:
                pause = self._composers.next_move()
                if pause is None:
                    return [Action(done=True)]
                home = pause.function == HOME
                self._current = (
                    Execution(maps={}, home=self._home) if home else self._execution(pause.args, pause.kwargs)
                )
            moved = self._move(self._current)
            if moved is not None:
                self._current.whole = moved.whole
                return moved.actions
            self._current = None

    def _move(self, current: Execution) -> Motion | None:
        """Return the next stretch of a motion; None when the motion is over."""
        return next_stretch(
            current, self._scene, self._roles, self._notes,
            subtask=self._composers.subtask, horizon_s=self.horizon_s, settle_s=self.settle_s,
        )  # fmt: skip

    def _execution(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Execution:
        """Return what a call of ``execute`` requests. Raises ProgramError for arguments that it does not take."""
        return Execution(maps=map_queries(arguments(self.execute, args, kwargs)))

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        return self._roles.composer_functions()

    def _try_execute(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        try:
            execution = self._execution(args, kwargs)
        except ProgramError as error:
            # A ValueError is reported with the program's name and line, as a mistake in every other call is.
            raise ValueError(str(error)) from None
        self._try(execution)

    def _try(self, execution: Execution) -> None:
        """Compose everything that a call of ``execute`` would use, without moving."""
        for query in execution.maps.values():
            self._roles.value_map(query)


def _transcript(language: str, record: Path | None) -> Transcript:
    transcript = transcript_of(language, record=record)
    if transcript is None:
        raise ConfigError("voxposer needs programs: --language replay:FILE.jsonl or live:MODEL, not rules-v1")
    return transcript
