"""One trial without a policy: give it actions, and it gives observations and a recording.

A trial's worker process, an environment for learning, the audit and your own loop all use it::

    with Episode(spec, card=card) as episode:
        observation = episode.reset()
        while observation is not None:
            observation = episode.step(policy.act(observation)).observation
        recording = episode.finish()
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Self, cast

import numpy as np

from carecontact.episode.drivers import Driver, driver_of
from carecontact.episode.log import (
    CellLog,
    Ended,
    ForceCut,
    LifeLog,
    TrialLog,
    cut_by_solver,
    cut_by_speed,
    cut_by_tool,
    header_of,
)
from carecontact.episode.perception import Peak, PerceptionLog
from carecontact.episode.randomization import (
    World,
    calibration,
    constants_of,
    sensor_noise,
    settled_world,
    under_control,
    with_draws_of,
)
from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.action import ACTION_SPACES, Action, ActionSpace
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import CONTROLS, Session
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import ARITHMETIC, RENDERER, arithmetic
from carecontact.recording.schema import SEGMENTS, EndReason, Failure, Recording
from carecontact.sensing.builder import ObservationBuilder, RawReadings
from carecontact.sensing.calibration import CameraPoses
from carecontact.sensing.grounded_sam import person_segmenter
from carecontact.sensing.keypoints import MediaPipePose
from carecontact.sim.controllers import CartesianControl
from carecontact.sim.impedance import steps_of_period
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import lengths


@dataclass(frozen=True, kw_only=True)
class Step:
    """The result of one action."""

    observation: Observation | None
    """None if none was requested or the episode has ended."""
    terminated: bool
    """Whether the policy said that it is done, or the benchmark stopped the trial because of a force or diverging
    physics."""
    truncated: bool
    """Whether the time limit was reached."""
    reason: EndReason | None
    """How the episode ended; None while it goes on."""


class Episode:
    """One trial without a policy. Use it as a context manager, because it holds a renderer that has to be closed."""

    def __init__(
        self,
        spec: TrialSpec,
        *,
        card: PolicyCard | None = None,
        prepare: Callable[[TrialSpec], World] | None = None,
        weights: Path | None = None,
        digest: Callable[[Observation], bytes] | None = None,
    ) -> None:
        """Build the world, let the person settle and put the clock to 0.

        Args:
            spec: the trial; its ``policy`` is a name for the recording only.
            card: what the policy requests; may be set later, but before ``reset``.
            prepare: gives the world at t = 0; by default ``settled_world`` builds it.
            weights: folder with the weights of the protocol's segmenter.
            digest: gives the 32 bytes that the recording keeps for an observation that was not sent over a wire; by
                default zeros. With ``hosting.wire.messages.observation_sha256`` they are those of a trial.

        Raises:
            ConfigError: the protocol has no such task.
            SceneError, SettleError: the world cannot be built.
        """
        started = time.monotonic()
        self.spec, self._card, self.protocol = spec, card, spec.protocol
        ids = [task.id for task in spec.protocol.tasks]
        if spec.task_id not in ids:
            raise ConfigError(f"no task {spec.task_id!r} in {spec.protocol.id}; valid: {', '.join(ids)}")
        self.task = spec.protocol.task(spec.task_id)
        self.simulation, self._settled, self._model_sha256 = (prepare or _world)(spec)
        # From here on, the protocol is the drawn one: it says where robot and camera are in this trial.
        self.protocol = with_draws_of(spec.protocol, self.simulation.protocol)
        self._weights, self._digest = weights, digest or (lambda observation: bytes(32))
        self._wall_s = [started, time.monotonic()]
        self._open = ExitStack()
        self._force_cut = ForceCut(self.protocol)
        self.privileged = False
        """Whether the policy is given the simulation; the recording says so."""
        self._driver: Driver | None = None
        self._builder: ObservationBuilder | None = None
        self._perception: PerceptionLog | None = None
        self._pending: Observation | None = None
        self._unanswered = False
        """Whether no action has been executed since the last observation."""
        self._done_steps = 0
        self._closed = False
        self._ended: Ended | None = None
        self._equip()

    def _equip(self) -> None:
        """Make what belongs to one compiled world at t = 0: the log, the renderer and the memory of the peak force."""
        self._cells, self._life = CellLog(self.simulation, self.task.region), LifeLog(self.simulation)
        self.log = TrialLog(
            human_joints=len(self.simulation.joint_names),
            regions=len(self.protocol.regions),
            constants={
                **constants_of(self.simulation, self._settled),
                **self._cells.constants(),
                **self._life.constants(),
            },
        )
        known = calibration(self.protocol, self.spec.seed, salt=self.spec.salt)
        self._renderer = SceneRenderer(self.simulation.model, protocol=self.protocol, calibration=known)
        self._poses = CameraPoses(self._renderer)
        self._peak = Peak(self.simulation, target=SEGMENTS.index(REGIONS[self.task.region].segment))
        self.simulation.start()
        self.log.add_state(self.simulation.time_s, self.simulation.integration_state())

    def __enter__(self) -> Self:
        self._open.enter_context(self._renderer)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._open.close()
        self._closed = True

    @property
    def card(self) -> PolicyCard | None:
        """The policy's card. Setting it after ``reset`` raises ConfigError."""
        return self._card

    @card.setter
    def card(self, card: PolicyCard) -> None:
        if self._perception is not None:
            raise ConfigError("Episode.card: it cannot change after reset; make a new Episode for another card")
        self._card = card

    @property
    def instruction(self) -> str:
        """The sentence that the policy receives."""
        return self.task.prompt

    @cached_property
    def session(self) -> Session:
        """What a policy learns before its first observation: limits and cameras."""
        return Session(
            action_bounds=self.protocol.impedance.action_bounds,
            joint_low_rad=self.simulation.robot.joint_low_rad,
            joint_high_rad=self.simulation.robot.joint_high_rad,
            camera_sizes_px={name: (c.width, c.height) for name, c in self.protocol.cameras.items()},
            time_limit_s=self.protocol.phases.time_limit_s,
        )

    @property
    def space(self) -> ActionSpace:
        """The card's action space. Raises ConfigError while the episode has no card."""
        if self.card is None:
            raise ConfigError("Episode: set the card before the action space is used")
        return ACTION_SPACES[self.card.action_space]

    @property
    def raw(self) -> RawReadings | None:
        """The readings behind the last observation, for the audit and never for a policy; None before ``reset``."""
        return None if self._builder is None else self._builder.raw

    def reset(self) -> Observation:
        """Return the first observation. An episode can be reset only once, because a trial uses up its world."""
        if self.card is None or self._perception is not None:
            raise ConfigError(
                "Episode.reset: set the card first, and call reset() once; make a new Episode for another trial"
            )
        card, dt_s = self.card, self.protocol.physics.dt_s
        control = CONTROLS[card.control]
        if control.joint is not None:
            self.simulation, self._model_sha256 = under_control(self.simulation, control)
            self._equip()
            self._open.enter_context(self._renderer)
        self._driver = driver_of(card, self.simulation)
        segmenter = person_segmenter(self.protocol, self._weights) if "masks" in card.modalities else None
        noise = sensor_noise(self.protocol, self.spec.seed, salt=self.spec.salt, noise_salt=self.spec.noise_salt)
        self._builder = ObservationBuilder(
            self._renderer, card, self.protocol, MediaPipePose(), noise=noise, segmenter=segmenter
        )
        self._perception = PerceptionLog(self.simulation.model, self._renderer)
        self._periods = steps_of_period(card.control_hz, dt_s)
        self._limit_steps = round(self.protocol.phases.time_limit_s / dt_s)
        return self._observe()

    def answered(self, *, sent_sha256: bytes | None = None, notes: Mapping[str, object] | None = None) -> None:
        """Record that the policy has answered the pending observation; ``step`` does so by itself.

        Args:
            sent_sha256: (32,) digest of the message that carried it; by default the episode's ``digest``.
            notes: what the policy noted of this step.

        Raises:
            PolicyError: the notes cannot be kept.
        """
        if self._pending is None or self._perception is None:
            return
        observation, self._pending = self._pending, None
        self.log.add_observation(observation, sent_sha256 or self._digest(observation))
        self.log.add_notes(notes or {})
        self._perception.add(self.simulation.data, observation)
        self._poses.add(self.simulation.data, observation)

    def step(self, action: Action, *, observe: bool = True) -> Step:
        """Execute one action for one period of the card's control rate.

        Args:
            observe: whether the next observation is wanted; a chunk of actions needs one only after its last.

        Raises:
            ActionError: ``action`` is no action or lies outside its space; the episode is unchanged.
            ConfigError: before ``reset``, after the end, or outside the episode's ``with``.
        """
        if self._perception is None or self._ended is not None or self._closed:
            raise ConfigError("Episode.step: call it after reset(), before the episode has ended, and inside its with")
        assert self.card is not None
        assert self._driver is not None
        checked, clipped = self.check(action)
        self.answered()
        if self._unanswered:
            self._unanswered = False
            if (ended := self._wait()) is not None:
                return ended
        period_s = 1.0 / self.card.control_hz
        entries = self._driver.apply(checked, period_s)
        clips = {"actions/clipped": np.array(clipped)} if self.card.out_of_bounds == "clip" else {}
        self.log.add_action(self.simulation.time_s, {**entries, **clips})
        self._run(next(self._periods))
        if self._ended is None and action.done:
            self._ended = Ended(reason="done")
        self._end_in_time()
        return self._outcome(observe=observe)

    def check(self, action: Action) -> tuple[Action, bool]:
        """Return an action as ``step`` executes it, in normal form, and whether it was moved into the bounds, as the
        card may request. Nothing else checks an action.

        Raises ActionError naming the field, what was expected and what was got.
        """
        if not isinstance(cast(object, action), Action):
            raise ActionError(f"expected one Action, got {type(action).__name__}; pass those of a list one by one")
        if self.card is None or self._driver is None:
            raise ConfigError("Episode.check: call it after reset()")
        inside = self.space.clip(action, self.session) if self.card.out_of_bounds == "clip" else action
        checked = self.space.check(inside, self.session)
        self._driver.check(checked)
        return checked, inside is not action

    def _wait(self) -> Step | None:
        """Simulate the protocol's latency while the last target stays in force.

        Returns how the trial ended meanwhile; None if it goes on.
        """
        steps = round(self.protocol.phases.latency_s / self.protocol.physics.dt_s)
        if steps:
            self._run(steps)
            self._end_in_time()
        return None if self._ended is None else self._outcome(observe=False)

    def _run(self, steps: int) -> None:
        steps = min(steps, self._limit_steps - self._done_steps)
        self._ended = self._advance(steps)
        self._done_steps += steps

    def _end_in_time(self) -> None:
        if self._ended is None and self._done_steps >= self._limit_steps:
            self._ended = Ended(reason="time_limit")

    def _outcome(self, *, observe: bool) -> Step:
        reason = None if self._ended is None else self._ended.reason
        return Step(
            observation=self._observe() if observe and reason is None else None,
            terminated=reason in ("done", "safety_truncation"),
            truncated=reason == "time_limit",
            reason=reason,
        )

    def fail(self, error: PolicyError) -> None:
        """End the episode because its policy failed; keep the policy's last observation and its notes on it."""
        if self._pending is not None:
            self.log.add_frames(self._pending)
        # If the notes of the failed step cannot be kept either, the policy's first failure is the one to report.
        with suppress(PolicyError):
            self.log.add_notes(error.notes, failed=True)
        self._ended = Ended(reason="process_failure", failure=Failure(kind=error.kind, message=str(error)))

    def finish(self) -> Recording:
        """Return the recording, which includes two pictures for the report. Raises ConfigError before the episode has
        ended.
        """
        if self._ended is None:
            raise ConfigError("Episode.finish: the episode has not ended; step until it has, or fail() it")
        extra, renders = self.log.extra, self._renderer.renders.copy()
        extra |= self._life.ended() | self._poses.arrays()
        if self._perception is not None:
            extra |= self._perception.arrays()
        extra |= self._peak.pictures(self._renderer, region=self.task.region)
        report_renders = (self._renderer.renders - renders).total()
        began, settled = self._wall_s
        extra["wall/seconds"] = np.array([settled - began, time.monotonic() - settled], "<f8")
        extra["wall/renders"] = np.array(
            [renders[k] for k in ("rgb", "depth", "robot_depth", "cell_depth", "truth")], "<f8"
        )
        extra["wall/report_renders"] = np.array([report_renders], "<f8")
        extra[ARITHMETIC] = np.frombuffer(arithmetic().encode(), "u1")
        extra[RENDERER] = np.frombuffer(self._renderer.drawn_by.encode(), "u1")
        header = header_of(
            self.spec, self.simulation, self._settled, self._ended, model_sha256=self._model_sha256,
            card=None if self.card is None else self.card.plain(),
            control=None if self.card is None else self.card.control, privileged=self.privileged,
        )  # fmt: skip
        unused = frozenset[str]() if self._driver is None else self._driver.unused
        arrays = {path: values for path, values in self.log.arrays().items() if path not in unused}
        return Recording(header=header, arrays=arrays)

    def _observe(self) -> Observation:
        assert self._builder is not None
        self.simulation.refresh()
        self._unanswered = True
        self._pending = self._builder.build(
            self.simulation.data, instruction=self.instruction, sim_time_s=self.simulation.time_s
        )
        return self._pending

    def _advance(self, steps: int) -> Ended | None:
        """Run ``steps`` physics steps. Returns why the benchmark stops the trial; None if it goes on."""
        simulation, physics = self.simulation, self.protocol.physics
        period = round(physics.target_period_s / physics.dt_s)
        while steps > 0:
            count = min(steps, period)
            samples = simulation.advance(count)
            steps -= count
            if (cut := cut_by_solver(simulation.solver_warnings())) is not None:
                return cut
            # A joint controller has limits of its own.
            if isinstance(simulation.control, CartesianControl):
                speed = np.concatenate([s.tcp_speed for s in samples])
                if (cut := cut_by_tool(speed, self.protocol)) is not None:
                    return cut
            self.log.add_period(
                samples, time_s=simulation.time_s, indentation_m=simulation.indentation(),
                target_in_base=simulation.control.target_in_base, cells=self._cells.period() | self._life.period(),
            )  # fmt: skip
            if self.log.wants_state(simulation.time_s):
                self.log.add_state(simulation.time_s, simulation.integration_state())
            force_n = np.concatenate([lengths(s.force) for s in samples])
            self._peak.look(force_n)
            cut = self._force_cut.cut(force_n) or cut_by_speed(simulation.fastest_joint)
            if cut is not None:
                return cut
        return None


def _world(spec: TrialSpec) -> World:
    return settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)


# What a policy sees at t = 0, without running a trial.


def first_look(
    protocol: Protocol, *, task_id: str, seed: int, card: PolicyCard, weights: Path | None = None, salt: str = ""
) -> Observation:
    """Return the first observation of a trial, with the modalities and cameras of the card.

    Args:
        weights: folder with the weights of the protocol's segmenter.
        salt: the secret of a salted run.

    Raises:
        SceneError, SettleError, DependencyError: as a trial does.
    """
    spec = TrialSpec(protocol=protocol, task_id=task_id, seed=seed, policy=card.name, salt=salt)
    with Episode(spec, card=card, weights=weights) as episode:
        return episode.reset()
