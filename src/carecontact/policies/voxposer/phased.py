"""``voxposer-phased``: value maps lead up to the touch, then a progress objective leads; nothing measures force."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import Parameter
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.errors import ProgramError
from carecontact.policies.voxposer.arguments import described, text_of
from carecontact.policies.voxposer.execution import EXECUTE, Execution, arguments
from carecontact.policies.voxposer.executor import Motion
from carecontact.policies.voxposer.policy import CAMERA, VoxPoser
from carecontact.policies.voxposer.progress import Objective, Pursuit, objective_functions
from carecontact.policies.voxposer.prompts import VOXPOSER_PHASED, PromptSet
from carecontact.policies.voxposer.seen_skin import touches
from carecontact.sight import person_points

F64 = npt.NDArray[np.float64]
ROLE = "get_progress"


@dataclass(frozen=True)
class ProgressQuery:
    """An objective as a program holds it: a description of what is to be achieved."""

    query: str
    description = "objective"


@dataclass(kw_only=True)
class PhasedExecution(Execution):
    """A call of ``execute`` that may carry a progress objective."""

    progress: ProgressQuery | None = None
    pursuit: Pursuit | None = None


class VoxPoserPhased(VoxPoser):
    """Works as VoxPoser, but a call of ``execute`` may carry an objective that replaces the maps once the tool touches.

    The method feels nothing: it takes the touch from where the skin was seen before the arm came near, or from the end
    of the value maps' own motion. See docs/voxposer-phased.md.
    """

    name = "voxposer-phased"
    prompts: PromptSet = VOXPOSER_PHASED
    authored = "authored-phased.jsonl"
    execute = EXECUTE.replace(
        parameters=[*EXECUTE.parameters.values(), Parameter("progress", Parameter.KEYWORD_ONLY, default=None)]
    )

    def reset(self, instruction: str) -> None:
        """Ask the planner for the subtasks, as VoxPoser does."""
        super().reset(instruction)
        self._skin: F64 | None = None

    def act(self, observation: Observation) -> Sequence[Action]:
        """Keep the skin of the first look, and act as VoxPoser does."""
        if self._skin is None:
            self._skin = person_points(observation.cameras[CAMERA])
        return super().act(observation)

    def _composer_functions(self) -> dict[str, Callable[..., object]]:
        def progress(query: object) -> object:
            return ClassInstance(ProgressQuery(text_of(query)))

        return super()._composer_functions() | {ROLE: progress}

    def _execution(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> PhasedExecution:
        progress = arguments(self.execute, args, kwargs).get("progress")
        if progress is not None and not isinstance(progress, ProgressQuery):
            raise ProgramError(f"execute: progress expects what {ROLE} returns, got {described(progress)}")
        return PhasedExecution(maps=super()._execution(args, kwargs).maps, progress=progress)

    def _try(self, execution: Execution) -> None:
        super()._try(execution)
        if isinstance(execution, PhasedExecution) and execution.progress is not None:
            self._objective(execution.progress)

    def _move(self, current: Execution) -> Motion | None:
        if not isinstance(current, PhasedExecution) or current.progress is None:
            return super()._move(current)
        tool = self._scene.pose_tcp
        assert self._skin is not None
        if current.pursuit is None:
            if not touches(self._skin, tool[:3]) and (motion := super()._move(current)) is not None:
                return motion
            current.pursuit = Pursuit(
                objective=self._objective(current.progress), skin=self._skin, start=tool[:3].copy()
            )
        pursuit = current.pursuit
        moved = pursuit.next_motion(tool, self._scene.grid)
        self._notes |= {
            "subtask": self._composers.subtask, "progress": current.progress.query,
            "progress_m": round(pursuit.done_m, 4), "progress_of_m": pursuit.objective.distance_m,
            "pursuing": moved is not None,
        }  # fmt: skip
        return moved

    def _objective(self, query: ProgressQuery) -> Objective:
        functions = {**self._roles.map_functions(), **objective_functions(self._scene.grid)}
        made = self._roles.result(ROLE, query.query, functions)
        if not isinstance(made, Objective):
            raise ProgramError(f"program {ROLE}: {query.query} leaves no objective in ret_val")
        return made
