"""The environments for learning as a benchmark of vla-eval: `benchmark: vla_eval_benchmark:BathingBenchmark`.

A model server of vla-eval then acts on persons of the training room. Its rates are for development: scores come from
`carecontact run` alone. The methods are those of `StepBenchmark` in allenai/vla-evaluation-harness e1ee9adf,
src/vla_eval/benchmarks/base.py.
"""

from typing import Any

import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, POSITION_DELTA, ROTATION_AA, DimSpec
from vla_eval.types import Action, EpisodeResult, Observation, Task

from carecontact.learn import TASKS, Bathing

STATE = DimSpec("state", 29, "carecontact_agent_pos")
DONE = DimSpec("done", 1, "done_positive", (-1, 1))


class BathingBenchmark(StepBenchmark):
    """One task of vla-eval is one task of the exam, and one episode one person."""

    render_backends = frozenset({"gpu", "cpu"})

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Nothing to set: OpenGL is found at the first picture."""
        return {}

    def __init__(self, level: str = "L1", tasks: list[str] | None = None, size: int = 224, seed: int = 0) -> None:
        super().__init__()
        self._tasks, self._seed = tuple(tasks or TASKS), seed
        self._env = Bathing(self._tasks, level, size=size)

    def get_tasks(self) -> list[Task]:
        prompts = {task: self._env.protocol.task(task).prompt for task in self._tasks}
        return [
            {"name": prompt, "suite": f"carecontact {self._env.level}", "id": task} for task, prompt in prompts.items()
        ]

    def reset(self, task: Task) -> Any:
        person = int(task.get("episode_idx", 0))
        return self._env.reset(seed=self._seed + person, options={"task": task["id"], "person": person})[0]

    def step(self, action: Action) -> StepResult:
        row = np.asarray(action.get("actions", action.get("action")), np.float64).ravel()
        seen, reward, terminated, truncated, info = self._env.step(row)
        return StepResult(obs=seen, reward=reward, done=terminated or truncated, info=info)

    def make_obs(self, raw_obs: Any, task: Task) -> Observation:
        return {"images": raw_obs["pixels"], "task_description": task["name"], "states": raw_obs["agent_pos"]}

    def get_step_result(self, step_result: StepResult) -> EpisodeResult:
        return {"success": bool(step_result.info.get("is_success", False))}

    def get_metadata(self) -> dict[str, Any]:
        return {"max_steps": self._env._max_episode_steps}

    def get_action_spec(self) -> dict[str, DimSpec]:
        return {"position": POSITION_DELTA, "rotation": ROTATION_AA, "done": DONE}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        return {"overhead": IMAGE_RGB, "wrist": IMAGE_RGB, "language": LANGUAGE, "state": STATE}

    def get_hold_action(self, last_action: Action | None) -> Action:
        """Stay at the last target."""
        return {"actions": np.array([0, 0, 0, 0, 0, 0, -1], np.float32)}

    def cleanup(self) -> None:
        self._env.close()
