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
from typing import Self, cast

import numpy as np

from carecontact.episode.drivers import Driver, driver_of
from carecontact.episode.log import STOPPED_OVER, PersonLog, TrialLog
from carecontact.episode.perception import Peak, PerceptionLog
from carecontact.episode.randomization import (
    World,
    calibration,
    drawn_facts,
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
from carecontact.recording.provenance import ARITHMETIC, DECLARED, RENDERER, arithmetic, trial_versions
from carecontact.recording.schema import SEGMENTS, EndReason, Failure, Header, Recording
from carecontact.sensing.builder import ObservationBuilder, RawReadings
from carecontact.sensing.calibration import CameraPoses
from carecontact.sensing.grounded_sam import person_segmenter
from carecontact.sensing.keypoints import MediaPipePose
from carecontact.sim.controllers import CartesianControl
from carecontact.sim.impedance import steps_of_period
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Samples, lengths
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256


@dataclass(frozen=True, kw_only=True)
class Step:
    """The result of one action."""

    observation: Observation | None
    """None if none was requested or the episode has ended."""
    terminated: bool
    """Whether the policy declared that it is done, or the benchmark stopped the trial for safety or because the physics
    diverged."""
    truncated: bool
    """Whether the time limit was reached."""
    reason: EndReason | None
    """How the episode ended; None while it goes on."""


@dataclass(frozen=True)
class Ended:
    """How an episode ended."""

    reason: EndReason
    failure: Failure | None = None
    """What went wrong; None where nothing did."""


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
                default zeros. With ``serving.codec.observation_sha256`` they are those of a trial.

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
        over_pain = self.protocol.phases.truncation_over_pain
        self._most_n = np.array([over_pain * self.protocol.f_pain(segment) for segment in SEGMENTS])
        """(S,) force [N] on each segment above which the benchmark stops the trial"""
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
        self._person = PersonLog(self.simulation, self.task.region)
        self.log = TrialLog(
            human_joints=len(self.simulation.joint_names),
            regions=len(self.protocol.regions),
            constants=self._person.constants(self._settled),
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

    def __exit__(self, *_: object) -> None:
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
            # The protocol's latency, during which the last target stays in force.
            self._run(round(self.protocol.phases.latency_s / self.protocol.physics.dt_s))
        if self._ended is None:
            row = dict(self._driver.apply(checked, 1.0 / self.card.control_hz))
            if self.card.out_of_bounds == "clip":
                row["actions/clipped"] = np.array(clipped)
            self.log.add_action(self.simulation.time_s, row)
            self._run(next(self._periods), done=action.done)
        reason = None if self._ended is None else self._ended.reason
        return Step(
            observation=self._observe() if observe and reason is None else None,
            terminated=reason in ("done", "safety_truncation"),
            truncated=reason == "time_limit",
            reason=reason,
        )

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

    def _run(self, steps: int, *, done: bool = False) -> None:
        """Run physics steps up to the time limit. ``done``: whether the policy declares that it is done after them."""
        steps = min(steps, self._limit_steps - self._done_steps)
        self._ended = self._advance(steps)
        self._done_steps += steps
        if self._ended is None and done:
            self._ended = Ended("done")
        elif self._ended is None and self._done_steps >= self._limit_steps:
            self._ended = Ended("time_limit")

    def fail(self, error: PolicyError) -> None:
        """End the episode because its policy failed; keep the policy's last observation and its notes on it."""
        if self._pending is not None:
            self.log.add_frames(self._pending)
        # If the notes of the failed step cannot be kept either, the policy's first failure is the one to report.
        with suppress(PolicyError):
            self.log.add_notes(error.notes, failed=True)
        self._ended = Ended("process_failure", Failure(kind=error.kind, message=str(error)))

    def finish(self) -> Recording:
        """Return the recording, which includes two pictures for the report. Raises ConfigError before the episode has
        ended.
        """
        if self._ended is None:
            raise ConfigError("Episode.finish: the episode has not ended; step until it has, or fail() it")
        extra, renders = self.log.extra, self._renderer.renders.copy()
        extra |= self._person.ended() | self._poses.arrays()
        if self._perception is not None:
            extra |= self._perception.arrays()
        extra |= self._peak.pictures(self._renderer, region=self.task.region)
        kinds = ("rgb", "depth", "robot_depth", "cell_depth", "truth")
        began, settled = self._wall_s
        extra["wall/seconds"] = np.array([settled - began, time.monotonic() - settled], "<f8")
        extra["wall/renders"] = np.array([renders[kind] for kind in kinds], "<f8")
        extra["wall/report_renders"] = np.array([(self._renderer.renders - renders).total()], "<f8")
        extra[ARITHMETIC] = np.frombuffer(arithmetic().encode(), "u1")
        extra[RENDERER] = np.frombuffer(self._renderer.drawn_by.encode(), "u1")
        unused = set[str]() if self._driver is None else self._driver.unused
        arrays = {path: values for path, values in self.log.arrays().items() if path not in unused}
        return Recording(header=self._header(self._ended), arrays=arrays)

    def _header(self, ended: Ended) -> Header:
        spec, card, simulation = self.spec, self.card, self.simulation
        scene, warnings = simulation.scene, simulation.solver_warnings()
        if simulation.normal_sum_truncated:
            warnings.append("normal-force sensor full: normal sums are too small")
        return Header(
            spec=spec,
            ended=ended.reason,
            failure=ended.failure,
            card=None if card is None else card.plain(),
            control=None if card is None else card.control,
            privileged=self.privileged,
            embodiment=simulation.robot.id,
            comfort_arm_deg=self._settled.comfort_arm_deg,
            segments=list(SEGMENTS),
            regions=list(spec.protocol.regions),
            human_joints=simulation.joint_names,
            pose_base_in_world=simulation.pose_base_in_world.tolist(),
            identity=DECLARED,
            versions=trial_versions(spec.protocol),
            sha256={
                "model": self._model_sha256,
                "body": scene.body.sha256,
                "robot": simulation.robot.source.sha256,
                "kernel": kernel_sha256(),
            },
            solver_warnings=warnings,
            drawn=drawn_facts(scene.protocol, scene.place) if spec.protocol.variation.draws_models else {},
        )

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
            if (stopped := self._unrecorded(samples)) is not None:
                return stopped
            row = {
                "scorer/period_time_s": simulation.time_s,
                "scorer/indentation_m": simulation.indentation(),
                "scorer/target_in_base": simulation.control.target_in_base,
            }
            self.log.add_period(samples, row | self._person.period())
            if self.log.wants_state(simulation.time_s):
                self.log.add_state(simulation.time_s, simulation.integration_state())
            force_n = np.concatenate([lengths(s.force) for s in samples])
            self._peak.look(force_n)
            over = force_n > self._most_n
            if over.any():
                step, segment = np.argwhere(over)[0]
                force = f"{force_n[step, segment]:.0f} N on {SEGMENTS[segment]}"
                return _stopped("force", f"{force}, cut at {self._most_n[segment]:.0f} N")
            if (fastest := simulation.control.fastest) is not None:
                speed = f"joint {fastest[0]} moved at {fastest[1]:.2f} rad/s"
                return _stopped("joint_speed", f"{speed}, faster than the robot's controller allows")
        return None

    def _unrecorded(self, samples: list[Samples]) -> Ended | None:
        """Return how a trial ends after a period that is no measurement and is therefore not recorded; None after any
        other: the solver diverged, or the tool was faster than a real robot allows, which stops itself at that moment
        (libfranka calls this ``cartesian_velocity_violation``).
        """
        if warnings := self.simulation.solver_warnings():
            return _stopped("solver", f"MuJoCo warning {', '.join(warnings)}")
        # A joint controller has limits of its own.
        if not isinstance(self.simulation.control, CartesianControl):
            return None
        most = STOPPED_OVER * self.protocol.physics.max_tcp_speed_m_s
        fastest = float(np.max([sample.tcp_speed.max() for sample in samples]))
        if fastest <= most:
            return None
        speed = f"the tool moved at {fastest:.2f} m/s"
        return _stopped("tool_speed", f"{speed}, and the robot stops itself above {most:.2f} m/s")


def _stopped(kind: str, message: str) -> Ended:
    """Return how a trial ends that the benchmark stops."""
    return Ended("safety_truncation", Failure(kind=kind, message=message))


def _world(spec: TrialSpec) -> World:
    return settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)


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
