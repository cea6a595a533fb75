"""The environments: one trial of the exam's protocol is one episode, with a person of the training room; one alone, or
several at once, each in a process of its own with one thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from carecontact.episode.episode import Episode, Step
from carecontact.episode.worlds import MOST_KEPT, Worlds
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.learned import MOST, LearnedActions, cloud, rotation_6d, square
from carecontact.interface.observation import Observation
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.interface.regions import REGIONS
from carecontact.learn.persons import numbers_of, training_spec
from carecontact.protocol.load import load_protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.scoring.online import Progress

F32 = npt.NDArray[np.float32]
Numbers = dict[str, Any]
Vector = gym.vector.VectorEnv[Any, Any, Any]

PROTOCOL = "bathing-wide-v2"
TASKS = ("T1", "T2", "T3", "T4", "T5", "T6", "T7")
LEVELS = ("L0", "L1", "L2", "L3")
HZ = 10.0
REWARDS = ("sparse", "dense")
LEAST_PX, MOST_PX = 32, 480
POINTS = 1024
FAR_M = 0.5
"""Distance of the tool from the region from which on a dense reward does not depend on it."""
MOST_N = 1000.0
"""Largest force in ``environment_state``; a trial ends far below."""


class Bathing(gym.Env[Numbers, F32]):
    """Touches, pushes and scrubs of the exam's protocol, at 10 Hz and for at most 30 s.

    Every trial has a person who is drawn with the training salt (``learn.persons``). ``reset(seed=s)`` decides person,
    task and noise of the sensors: the same seed gives the same trial to the last bit, whatever came before.
    ``options`` may name a ``person`` by number and a ``task`` by id; other entries are ignored.

    Observation: ``agent_pos`` (29,), as ``interface.learned.LearnedActions`` describes it; ``pixels``, a picture
    (size, size, 3) for each camera, which ``interface.learned.square`` makes of what the exam's camera sees; and on
    request ``points`` (1024, 6) of the overhead camera, as ``interface.learned.cloud`` draws them.

    Action: a row (7,) of numbers from -1 to 1, as ``LearnedActions.action`` describes it.

    Reward: ``sparse`` is 1 at the end of a trial that passes its gate and was safe, else 0. ``dense`` adds the change
    of a potential, the share of the gate that is reached minus the distance from the region [m], and -1 where the trial
    becomes unsafe: it is made of what no policy may know (``Episode.privileged``), and is for training only.

    ``info`` has ``is_success``, ``task_description``, ``task`` and ``person`` at every step, and ``ended`` at the last.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": int(HZ)}
    sees_truth: ClassVar[bool] = False

    def __init__(
        self,
        tasks: str | Sequence[str] = TASKS,
        level: str = "L1",
        persons: int | Sequence[int] = 27,
        *,
        cameras: Sequence[str] = ("overhead", "wrist"),
        size: int = 128,
        points: bool = False,
        nested: bool = True,
        reward: str = "sparse",
        absolute: bool = False,
        may_end: bool = True,
        worlds: int = MOST_KEPT,
        record: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """Nothing is simulated or drawn before the first ``reset``.

        Args:
            tasks: ids of which every trial has one.
            persons: how many, from number 0 on, or their numbers. Other numbers are other people, for validation.
            cameras: which pictures there are; none for ().
            size: width and height of the pictures [px].
            nested: whether pictures are ``pixels`` -> camera, as LeRobot expects it, or stand beside the other parts as
                ``pixels.camera``, for libraries without nested observations.
            absolute: whether a row is a target in the workspace, and not a difference to the last one.
            may_end: whether the last number of a row ends the trial; otherwise only the time limit does.
            worlds: how many compiled worlds are kept, about 80 MiB each. A trial with a person and task whose world is
                kept begins in milliseconds, any other in about a second.
            record: whether ``episode.finish()`` gives a recording; no ranking accepts it.

        Raises ConfigError naming the argument and what is valid.
        """
        self.tasks = (tasks,) if isinstance(tasks, str) else tuple(tasks)
        for task in self.tasks or ("",):
            if task not in TASKS:
                raise UnknownNameError("task", task, TASKS)
        if isinstance(cameras, str):
            raise ConfigError(f"Bathing.cameras: expected several names, such as ({cameras!r},), got {cameras!r:.40}")
        if unknown := [name for name in cameras if name not in CAMERAS]:
            raise UnknownNameError("camera", unknown[0], CAMERAS)
        if reward not in REWARDS:
            raise UnknownNameError("reward", reward, REWARDS)
        if type(size) is not int or not LEAST_PX <= size <= MOST_PX:
            raise ConfigError(f"Bathing.size: expected {LEAST_PX} to {MOST_PX} px, got {size!r:.40}")
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"Bathing.render_mode: expected rgb_array or None, got {render_mode!r:.40}")
        self.persons, self.level, self.cameras = numbers_of(persons), level, tuple(dict.fromkeys(cameras))
        self.render_mode, self._reward_kind, self._may_end = render_mode, reward, may_end
        self._points, self._nested, self._record, self._size = points, nested, record, size
        taking = (*self.cameras, "overhead") if points and "overhead" not in self.cameras else self.cameras
        self.card = PolicyCard(
            name="carecontact.learn",
            modalities=("rgb", "depth") if points else ("rgb",) if self.cameras else (),
            cameras=taking,
            control_hz=HZ,
        )
        self.protocol = load_protocol(PROTOCOL, level=level)
        self._max_episode_steps = round(self.protocol.phases.time_limit_s * HZ)
        self._rows = LearnedActions(self.protocol.impedance.action_bounds, absolute=absolute)
        self._worlds = Worlds(worlds)
        self._episode: Episode | None = None
        self._progress: Progress | None = None
        self.action_space = gym.spaces.Box(-1.0, 1.0, (7,), np.float32)
        self.observation_space = gym.spaces.Dict(self._spaces())

    @property
    def episode(self) -> Episode:
        """The running trial. It knows everything: no policy may be given it. Raises ConfigError before ``reset``."""
        if self._episode is None:
            raise ConfigError("Bathing: call reset() first")
        return self._episode

    @property
    def task(self) -> str:
        """Id of the trial's task."""
        return self.tasks[0] if self._episode is None else self._episode.spec.task_id

    @property
    def task_description(self) -> str:
        """The sentence that a policy of the exam receives for the task."""
        return self.protocol.task(self.task).prompt

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Numbers, Numbers]:
        super().reset(seed=seed)
        wanted, draw = options or {}, self.np_random
        person = self.persons[int(draw.integers(len(self.persons)))]
        task = self.tasks[int(draw.integers(len(self.tasks)))]
        noise = draw.bytes(16).hex()
        person, task = wanted.get("person", person), wanted.get("task", task)
        if task not in TASKS:
            raise UnknownNameError("task", str(task), TASKS)
        spec = training_spec(self.protocol, task, *numbers_of([person]), noise_salt=noise)
        if self._episode is None:
            self._episode = Episode(spec, card=self.card, worlds=self._worlds, record=self._record)
            # A dense reward is made of what no policy may know, and so is the state. Where there is no recording to say
            # so, this only keeps what the verdict at the end needs.
            self._episode.privileged = self.sees_truth or self._reward_kind == "dense" or not self._record
        self._progress = None
        first = self._episode.reset(spec)
        self._rows.begin(first)
        return self._numbers(first), self._info()

    def step(self, action: npt.ArrayLike) -> tuple[Numbers, float, bool, bool, Numbers]:
        """Execute a row (7,). Raises ActionError for another shape and for what is not finite."""
        row = np.array(action, np.float64)
        if row.shape == (7,) and not self._may_end:
            row[6] = -1.0
        step = self.episode.step(self._rows.action(row))
        reward = self._reward(step)
        last = step.observation or self.episode.look()
        ended = {} if step.reason is None else {"ended": step.reason}
        return self._numbers(last), reward, step.terminated, step.truncated, self._info() | ended

    def render(self) -> npt.NDArray[np.uint8] | None:  # type: ignore[override]
        """Return what the exterior camera sees (H, W, 3), for people who watch."""
        return None if self.render_mode is None else self.episode.picture("exterior")

    def close(self) -> None:
        if self._episode is not None:
            self._episode.close()
            self._episode = None
        self._worlds.clear()

    def _reward(self, step: Step) -> float:
        before, dense = self._progress, self._reward_kind == "dense"
        if step.reason is None and not (dense or self.sees_truth):
            return 0.0
        # A trial that the benchmark stopped in its first control period has measured nothing.
        now = self.episode.progress() if self.episode.measured else None
        self._progress = now
        reward = float(step.reason is not None and now is not None and now.safety_gated)
        if dense and now is not None:
            unsafe = not now.safe and (before is None or before.safe)
            reward += (0.0 if before is None else _potential(now) - _potential(before)) - float(unsafe)
        return reward

    def _info(self) -> Numbers:
        now, ended = self._progress, self.episode.ended
        return {
            "is_success": bool(ended and now is not None and now.safety_gated),
            "task_description": self.task_description,
            "task": self.task,
            "person": self.episode.spec.seed,
        }

    def _spaces(self) -> dict[str, gym.Space[Any]]:
        most = MOST.astype(np.float32)
        spaces: dict[str, gym.Space[Any]] = {"agent_pos": gym.spaces.Box(-most, most, dtype=np.float32)}
        pictures = {name: gym.spaces.Box(0, 255, (self._size, self._size, 3), np.uint8) for name in self.cameras}
        if self._points:
            spaces["points"] = gym.spaces.Box(-2.0, 2.0, (POINTS, 6), np.float32)
        return spaces | self._placed(pictures, gym.spaces.Dict)

    def _placed(self, pictures: Mapping[str, Any], kind: type = dict) -> dict[str, Any]:
        if not self._nested:
            return {f"pixels.{name}": picture for name, picture in pictures.items()}
        return {"pixels": kind(pictures)} if pictures else {}

    def _numbers(self, seen: Observation) -> Numbers:
        out: Numbers = {"agent_pos": self._rows.agent_pos(seen)}
        if self._points:
            # Pixels are drawn alike in every observation: what differs is what is seen there.
            drawn, bounds = np.random.default_rng(0), self.protocol.impedance.action_bounds
            out["points"] = cloud(seen.cameras["overhead"], POINTS, bounds, drawn)
        return out | self._placed({name: square(seen.cameras[name].rgb, self._size) for name in self.cameras})


class BathingState(Bathing):
    """The same with the truth: privileged. What learns here needs what no policy of the exam is given, unless it is a
    teacher or a critic of one that does not.

    Observation: besides ``agent_pos``, and pictures where ``cameras`` names any, ``environment_state``: for each of
    ``recording.schema.SEGMENTS`` the force of the robot on it [N], mean over the last period; the force (3,) on the
    named segment in base; pose of the named region in base, position (3,) [m] and ``rotation_6d`` (6,), and its size
    (3,) [m]; the middle of the foam in base (3,) [m], or of the region where there is no foam; the share of the gate
    that is reached, whether it is met, and whether the trial is safe; and 1 for the trial's task among TASKS. ``info``
    has the forces by segment as ``force_n``.
    """

    sees_truth: ClassVar[bool] = True

    def __init__(
        self, tasks: str | Sequence[str] = TASKS, level: str = "L1", persons: int | Sequence[int] = 27, **others: Any
    ) -> None:
        """See ``Bathing``; by default, there are no pictures."""
        self._force_n = np.zeros(len(SEGMENTS))
        super().__init__(tasks, level, persons, **{"cameras": (), **others})

    def _spaces(self) -> dict[str, gym.Space[Any]]:
        high = np.concatenate(
            [
                np.full(len(SEGMENTS), MOST_N),
                np.full(3, MOST_N),
                *(np.full(3, 3.0), np.ones(6), np.full(3, 2.0), np.full(3, 3.0)),
                np.ones(3 + len(TASKS)),
            ]
        ).astype(np.float32)
        low = -high
        low[: len(SEGMENTS)] = low[-3 - len(TASKS) :] = 0.0
        self._low, self._high = low, high
        return {**super()._spaces(), "environment_state": gym.spaces.Box(low, high, dtype=np.float32)}

    def _numbers(self, seen: Observation) -> Numbers:
        return {**super()._numbers(seen), "environment_state": self._state()}

    def _info(self) -> Numbers:
        return {**super()._info(), "force_n": dict(zip(SEGMENTS, self._force_n.tolist(), strict=True))}

    def _state(self) -> F32:
        episode, simulation, now = self.episode, self.episode.simulation, self._progress
        force = episode.force()
        self._force_n = np.linalg.norm(force, axis=1)
        region, named = episode.task.region, SEGMENTS.index(REGIONS[episode.task.region].segment)
        to_base = matrix_from_quat(simulation.pose_base_in_world[3:]).T
        site = simulation.data.site(f"region_{region}")
        pose = simulation.encoders.in_base(simulation.data, site.xpos, site.xmat)
        size, patch = simulation.scene.frames[region].size_m, simulation.scene.foam
        foam = pose[:3, 3] if patch is None else pose[:3, :3] @ patch.middle + pose[:3, 3]
        reached = [0.0, 0.0, 1.0] if now is None else [now.share, float(now.success), float(now.safe)]
        task = [float(name == self.task) for name in TASKS]
        where = pose[:3, 3], rotation_6d(pose[:3, :3]), size, foam
        parts = self._force_n, to_base @ force[named], *where, reached, task
        return np.clip(np.concatenate(parts), self._low, self._high).astype(np.float32)


def _potential(progress: Progress) -> float:
    return progress.share - min(max(progress.distance_m, 0.0), FAR_M)


def make_vec(env_id: str, n: int, *, asynchronous: bool = True, **arguments: Any) -> Vector:
    """Return ``n`` environments that step together; one that has ended begins again with the next step.

    Where ``persons`` are given and there are at least ``n`` of them, each environment has a share of its own, so that
    each process has fewer worlds to keep.

    Args:
        env_id: such as ``carecontact/Bathing-T1-L1-v0``.
        n: one for each core is as fast as it gets.
        asynchronous: whether each has a process of its own; OpenGL then begins there, and nothing is shared.
        arguments: those of ``Bathing``.

    Raises ConfigError for ``n`` below 1.
    """
    if n < 1:
        raise ConfigError(f"make_vec.n: expected at least 1, got {n}")
    shares: list[dict[str, Any]] = [arguments] * n
    if "persons" in arguments and len(numbers := numbers_of(arguments["persons"])) >= n:
        shares = [{**arguments, "persons": numbers[first::n]} for first in range(n)]
    made = [partial(_made, env_id, share, alone=asynchronous) for share in shares]
    mode = gym.vector.AutoresetMode.NEXT_STEP
    if asynchronous:
        return gym.vector.AsyncVectorEnv(made, context="spawn", autoreset_mode=mode)
    return gym.vector.SyncVectorEnv(made, autoreset_mode=mode)


def _made(env_id: str, arguments: dict[str, Any], *, alone: bool) -> gym.Env[Any, Any]:
    if alone:
        threadpool_limits(1)
    return gym.make(env_id, disable_env_checker=True, **arguments)
