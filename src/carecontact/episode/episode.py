"""One trial without a policy: give it actions, and it gives observations and a recording.

A trial's worker process, an environment for learning, the audit and your own loop all use it::

    with Episode(spec, card=card) as episode:
        observation = episode.reset()
        while observation is not None:
            observation = episode.step(policy.act(observation)).observation
        recording = episode.finish()

A learner resets one episode again and again, to the same trial or to another::

    with Episode(spec, card=card, worlds=Worlds(), record=False) as episode:
        observation = episode.reset(spec.model_copy(update={"seed": 3}))
        step = episode.step(action)
        last = step.observation or episode.look()
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self, cast

import numpy as np
import numpy.typing as npt

from carecontact.episode.drivers import Driver, driver_of
from carecontact.episode.log import STOPPED_OVER, Foam, PersonLog, TrialLog
from carecontact.episode.looks import Control, Looks, control_of, flags
from carecontact.episode.perception import Peak, PerceptionLog
from carecontact.episode.randomization import World, drawn_facts, sensor_noise
from carecontact.episode.worlds import KeptWorld, Worlds
from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.action import ACTION_SPACES, Action, ActionSpace
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import CARTESIAN_IMPEDANCE, Session
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import ARITHMETIC, DECLARED, RENDERER, arithmetic, trial_versions
from carecontact.recording.schema import SEGMENTS, EndReason, Failure, Header, Recording
from carecontact.scoring.foam import ENDS_S
from carecontact.scoring.online import NEEDED, Progress, progress_of
from carecontact.sensing.builder import ObservationBuilder, RawReadings
from carecontact.sensing.calibration import CameraPoses
from carecontact.sensing.grounded_sam import person_segmenter
from carecontact.sensing.keypoints import PoseEstimator
from carecontact.sensing.segmentation import PersonSegmenter
from carecontact.sim.controllers import CartesianControl
from carecontact.sim.impedance import steps_of_period
from carecontact.sim.simulation import Samples, lengths
from carecontact.tissue.plugin import loaded_sha256


@dataclass(frozen=True, kw_only=True)
class Step:
    """The result of one action."""

    observation: Observation | None
    """None if none was requested or the episode has ended; then ``Episode.look`` gives the last one."""
    terminated: bool
    """Whether the policy declared that it is done, or the benchmark stopped the trial for safety or because the physics
    diverged."""
    truncated: bool
    """Whether the time limit was reached."""
    reason: EndReason | None
    """How the episode ended; None while it goes on."""


Teaching = Callable[[Action], tuple[Action, Action | None]]
"""Takes the action that a policy chose; returns the one to execute, and, for a demonstration in which it is another,
what the demonstrator would have it do (``oracle.teaching``)."""


@dataclass(frozen=True)
class Ended:
    """How an episode ended."""

    reason: EndReason
    failure: Failure | None = None
    """What went wrong; None where nothing did."""


class Episode:
    """One trial without a policy, or one after another. Use it as a context manager, or ``close`` it, because it holds
    a renderer."""

    def __init__(
        self,
        spec: TrialSpec,
        *,
        card: PolicyCard | None = None,
        prepare: Callable[[TrialSpec], World] | None = None,
        worlds: Worlds | None = None,
        weights: Path | None = None,
        digest: Callable[[Observation], bytes] | None = None,
        record: bool = True,
    ) -> None:
        """Build the world, let the person settle and put the clock to 0.

        Args:
            spec: the trial; its ``policy`` is a name for the recording only.
            card: what the policy requests; may be set later, but before ``reset``.
            prepare: gives the world at t = 0; by default ``settled_world`` builds it.
            worlds: keeps the worlds between resets, and for other episodes of this process. By default, this episode
                keeps the world of its own trial alone.
            weights: folder with the weights of the protocol's segmenter.
            digest: gives the 32 bytes that the recording keeps for an observation that was not sent over a wire; by
                default zeros. With ``serving.codec.observation_sha256`` they are those of a trial.
            record: whether the trial is recorded; without a recording, a step takes less time.

        Raises:
            ConfigError: ``spec`` is not a trial, its protocol lacks the task, its seed is not an integer of at least 0,
                or both ``prepare`` and ``worlds`` are given.
            SceneError, SettleError: the world cannot be built.
        """
        if prepare is not None and worlds is not None:
            raise ConfigError("Episode: give prepare to Worlds, and the worlds to the episode")
        self._card, self._record = card, record
        self._worlds = Worlds(1, prepare=prepare) if worlds is None else worlds
        self._shared = worlds is not None
        self._weights, self._digest = weights, digest or (lambda observation: bytes(32))
        self._keypoints, self._segmenters = PoseEstimator(), dict[str, PersonSegmenter | None]()
        self.privileged = False
        """Whether the policy is given the simulation; the recording says so."""
        self.control = ""
        """Control of what the policy observes, from LOOK_CONTROLS; set it before ``reset``."""
        self._control: Control | None = None
        self._closed = False
        self._taken: KeptWorld | None = None
        """The world that has to be given back."""
        self._begin(spec)

    def _begin(self, spec: TrialSpec) -> None:
        """Make the trial of ``spec`` the one of this episode, at t = 0 and before its first observation."""
        started = time.monotonic()
        _check(spec)
        self.spec, self.task, self._fresh = spec, spec.protocol.task(spec.task_id), False
        self._driver: Driver | None = None
        self._builder: ObservationBuilder | None = None
        self._perception: PerceptionLog | None = None
        self._pending: Observation | None = None
        """The last observation, with its new views only, until the policy has answered it."""
        self._unanswered = False
        """Whether no action has been executed since the last observation."""
        self._done_steps = 0
        self._ended: Ended | None = None
        self._enter_world(CARTESIAN_IMPEDANCE if self._card is None else self._card.control)
        self._wall_s = [started, time.monotonic()]
        over_pain = self.protocol.phases.truncation_over_pain
        self._most_n = np.array([over_pain * self.protocol.f_pain(segment) for segment in SEGMENTS])
        """(S,) force [N] on each segment above which the benchmark stops the trial"""
        self._fresh = True
        """Whether the world is at t = 0 and no trial has begun in it."""

    def _enter_world(self, control: str) -> None:
        """Take the trial's world, whose robot is under this control."""
        world = self._world = self._taken = self._worlds.take(self.spec, control, instead_of=self._taken)
        # From here on, the protocol is the drawn one: it says where robot and camera are in this trial.
        self.simulation, self.protocol, self._renderer = world.simulation, world.protocol, world.renderer
        self.__dict__.pop("session", None)
        self._person = PersonLog(self.simulation, self.task.region)
        constants = self._person.constants(world.settled)
        self.log = TrialLog(
            human_joints=len(self.simulation.joint_names), regions=len(self.protocol.regions), constants=constants
        )
        self._poses = CameraPoses(self._renderer)
        target = SEGMENTS.index(REGIONS[self.task.region].segment)
        self._peak = Peak(self.simulation, target=target)
        self._foam = Foam(self.simulation, target, constants, self._renderer)
        self.simulation.start()
        if self._record:
            self.log.add_state(self.simulation.time_s, self.simulation.integration_state())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the world back, or close its renderer where no other episode may need it."""
        self._closed = True
        if self._taken is not None:
            self._worlds.give_back(self._taken)
            self._taken = None
        if not self._shared:
            self._worlds.clear()

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
        """What a policy learns before its first observation: limits, cameras, compliance, and the arm's errors."""
        errors = self.protocol.arm_errors
        return Session(
            action_bounds=self.protocol.impedance.action_bounds,
            joint_low_rad=self.simulation.robot.joint_low_rad,
            joint_high_rad=self.simulation.robot.joint_high_rad,
            camera_sizes_px={name: (c.width, c.height) for name, c in self.protocol.cameras.items()},
            time_limit_s=self.protocol.phases.time_limit_s,
            compliance=self.protocol.impedance.compliance if self._world.control == CARTESIAN_IMPEDANCE else None,
            force_bias_n=0.0 if errors is None else errors.force_bias_n,
            joint_friction_nm=() if errors is None else errors.joint_friction_nm(self.simulation.robot),
        )

    @property
    def space(self) -> ActionSpace:
        """The card's action space. Raises ConfigError while the episode has no card."""
        if self.card is None:
            raise ConfigError("Episode: set the card before the action space is used")
        return ACTION_SPACES[self.card.action_space]

    @property
    def _rated(self) -> bool:
        """Whether any camera of the card has a rate, so that an observation may lack its view."""
        return self._card is not None and bool(self._card.camera_hz)

    @property
    def raw(self) -> RawReadings | None:
        """The readings behind the last observation, for the audit and never for a policy; None before ``reset``."""
        return None if self._builder is None else self._builder.raw

    def reset(self, spec: TrialSpec | None = None) -> Observation:
        """Begin a trial, and return its first observation.

        Args:
            spec: another trial than the last one; by default the same again, equal to the last bit.

        Raises:
            ConfigError: the card is not set, the episode is closed, or ``spec`` is wrong as in the constructor; the
                episode is then as it was.
            SceneError, SettleError: the world cannot be built, and no step is possible before another reset.
        """
        self._check_open("reset")
        if self.card is None:
            raise ConfigError("Episode.reset: set the card first")
        card = self.card
        if not self._fresh or spec not in (None, self.spec):
            self._begin(spec or self.spec)
        self._fresh = False
        if card.control != self._world.control:
            # The card came after the world.
            self._enter_world(card.control)
        dt_s = self.protocol.physics.dt_s
        self._driver = driver_of(card, self.simulation)
        wanted = self.protocol.vision.weights_sha256
        if "masks" in card.modalities and wanted not in self._segmenters:
            self._segmenters[wanted] = person_segmenter(self.protocol, self._weights)
        noise = sensor_noise(self.protocol, self.spec.seed, salt=self.spec.salt, noise_salt=self.spec.noise_salt)
        self._builder = ObservationBuilder(
            self._renderer,
            card,
            self.protocol,
            self._keypoints,
            noise=noise,
            segmenter=self._segmenters.get(wanted),
        )
        self._perception = PerceptionLog(self.simulation.model, self._renderer)
        self._looks = Looks(card, dt_s=dt_s)
        self._control = control_of(self.control, self, weights=self._weights) if self.control else None
        self._periods = steps_of_period(card.control_hz, dt_s)
        self._limit_steps = round(self.protocol.phases.time_limit_s / dt_s)
        return self._observe()

    def _check_open(self, method: str) -> None:
        if self._closed:
            raise ConfigError(f"Episode.{method}: the episode is closed; call it inside its with")

    def look(self) -> Observation:
        """Return what a policy would see now: after the end, the last observation of the trial. It leaves no trace in
        the recording. Raises ConfigError before ``reset``.
        """
        self._check_open("look")
        if self._builder is None:
            raise ConfigError("Episode.look: call it after reset()")
        self.simulation.refresh()
        return self._builder.build(
            self.simulation.data, instruction=self.instruction, sim_time_s=self.simulation.time_s
        )

    def progress(self) -> Progress:
        """Return how far the trial has come toward the gate of its task, by the rules of the score: for rewards, in an
        episode that is ``privileged``; in any other one, after its end.

        Raises ConfigError before that, and where nothing was measured (``measured``).
        """
        if not (self.privileged or self._ended is not None):
            raise ConfigError(
                "Episode.progress: it knows what no policy may know; set episode.privileged = True before reset(), "
                "which recordings then say, or call it after the end"
            )
        if not self.measured:
            raise ConfigError(
                "Episode.progress: nothing was measured; call it after the first step of an episode that records or "
                "is privileged"
            )
        ended = Ended("time_limit") if self._ended is None else self._ended
        header = Header.model_construct(
            spec=self.spec,
            ended=ended.reason,
            failure=ended.failure,
            embodiment=self.simulation.robot.id,
            segments=list(SEGMENTS),
            regions=list(self.protocol.regions),
            human_joints=self.simulation.joint_names,
        )
        return progress_of(Recording.trusted(header, self.log.measured(NEEDED)))

    @property
    def ended(self) -> bool:
        """Whether the trial has ended."""
        return self._ended is not None

    @property
    def measured(self) -> bool:
        """Whether a control period of the trial was measured; not where the benchmark stopped it in its first one."""
        return self.log.measures

    def force(self) -> npt.NDArray[np.float64]:
        """Return the force (S, 3) [N] of the robot on each segment in the world, mean over the last period of the
        card's control rate; zeros before the first. Raises ConfigError for an episode that is not ``privileged``."""
        if not self.privileged or self.card is None:
            raise ConfigError("Episode.force: no policy may know it; set episode.privileged = True before reset()")
        return self.log.mean_force(round(1.0 / (self.card.control_hz * self.protocol.physics.dt_s)))

    def picture(self, camera: str) -> npt.NDArray[np.uint8]:
        """Return what a camera sees now (H, W, 3), for people who watch. Raises SceneError for an unknown camera."""
        self.simulation.refresh()
        self._foam.show()
        return self._renderer.rgb(self.simulation.data, camera)

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
        if not self._record:
            return
        looked = flags(observation.new) if self._rated else None
        self.log.add_observation(observation, sent_sha256 or self._digest(observation), looked=looked)
        self.log.add_notes(notes or {})
        self._perception.add(self.simulation.data, observation)
        self._poses.add(self.simulation.data, observation)

    def step(self, action: Action, *, observe: bool = True, demonstrated: Action | None = None) -> Step:
        """Execute one action for one period of the card's control rate.

        Args:
            observe: whether the next observation is wanted; a chunk of actions needs one only after its last.
            demonstrated: what a demonstrator would have done here, for the recording; give it at every step of a trial
                or at none.

        Raises:
            ActionError: ``action`` is no action or lies outside its space; the episode is unchanged.
            ConfigError: before ``reset``, after the end, or outside the episode's ``with``.
        """
        self._check_open("step")
        if self._ended is not None:
            raise ConfigError(f"Episode.step: the trial has ended ({self._ended.reason}); call reset() or finish()")
        if self._perception is None:
            raise ConfigError("Episode.step: call reset() first")
        assert self.card is not None
        assert self._driver is not None
        checked, clipped = self.check(action)
        self.answered()
        self._looks.ask(action.look)
        if self._unanswered:
            self._unanswered = False
            # The protocol's latency, during which the last target stays in force.
            self._run(round(self.protocol.phases.latency_s / self.protocol.physics.dt_s))
        if self._ended is None:
            row: dict[str, object] = dict(self._driver.apply(checked, 1.0 / self.card.control_hz))
            if self.card.out_of_bounds == "clip":
                row["actions/clipped"] = np.array(clipped or self._driver.clipped)
            if self._rated:
                row["actions/look"] = flags(action.look)
            if demonstrated is not None:
                pose = demonstrated.pose_tcp_in_base
                row["actions/demonstrated"] = np.append([np.nan] * 7 if pose is None else pose, demonstrated.done)
            if self._record:
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
        inside = action
        if self.card.out_of_bounds == "clip":
            inside = self._driver.clip(self.space.clip(action, self.session))
        checked = self.space.check(inside, self.session)
        self._driver.check(checked)
        self._looks.check(action.look)
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
        """Return the recording, which includes two pictures for the report. Its header says that the policy was not in
        a process of its own (``Header.origin``).

        Raises ConfigError before the episode has ended, and for an episode that does not record.
        """
        if not self._record:
            raise ConfigError("Episode.finish: this episode was made with record=False; make one that records")
        if self._ended is None:
            raise ConfigError("Episode.finish: the episode has not ended; step until it has, or fail() it")
        extra, renders = self.log.extra, self._renderer.renders.copy()
        extra |= self._person.ended() | self._poses.arrays()
        if self._perception is not None:
            extra |= self._perception.arrays()
        self._foam.show()
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
            origin="in-process",
            embodiment=simulation.robot.id,
            comfort_arm_deg=self._world.settled.comfort_arm_deg,
            segments=list(SEGMENTS),
            regions=list(spec.protocol.regions),
            human_joints=simulation.joint_names,
            pose_base_in_world=simulation.pose_base_in_world.tolist(),
            identity=DECLARED,
            versions=trial_versions(spec.protocol),
            sha256={
                "model": self._world.model_sha256,
                "body": scene.body.sha256,
                "robot": simulation.robot.source.sha256,
                "kernel": loaded_sha256(),
            },
            solver_warnings=warnings,
            drawn=drawn_facts(scene.protocol, scene.place, simulation.force_bias_n) if spec.protocol.draws else {},
        )

    def _observe(self) -> Observation:
        assert self._builder is not None
        self.simulation.refresh()
        self._foam.show()
        self._unanswered = True
        time_s = self.simulation.time_s
        taking = self._looks.due(time_s)
        built = self._builder.build(
            self.simulation.data, instruction=self.instruction, sim_time_s=time_s, cameras=taking
        )
        self._pending = built if self._control is None else self._control(built)
        return self._looks.completed(self._pending)

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
            felt = self._person.period() if self._record or self._foam.present else {}
            self._foam.add(simulation.time_s, samples, felt)
            force_n = np.concatenate([lengths(s.force) for s in samples])
            if self._record:
                row = {
                    ENDS_S: simulation.time_s,
                    "scorer/indentation_m": simulation.indentation(),
                    "scorer/target_in_base": simulation.control.target_in_base,
                }
                self.log.add_period(samples, row | felt)
                if self.log.wants_state(simulation.time_s):
                    self.log.add_state(simulation.time_s, simulation.integration_state())
                self._peak.look(force_n)
            elif self.privileged:
                # All that progress toward the gate needs.
                self.log.add_period(samples, {ENDS_S: simulation.time_s} | felt if self._foam.present else {})
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
        """How a trial ends after a period that is no measurement: the solver diverged, or the tool was faster than a
        real robot allows, which then stops itself (libfranka's ``cartesian_velocity_violation``)."""
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


def _check(spec: object) -> None:
    """Raises ConfigError if ``spec`` is not a valid trial. It runs before anything of the episode changes."""
    if not isinstance(spec, TrialSpec):
        raise ConfigError(
            f"Episode: expected a TrialSpec, got {spec!r:.80}; another trial of the same protocol is "
            "episode.spec.model_copy(update={'task_id': ..., 'seed': ...})"
        )
    ids, seed = [task.id for task in spec.protocol.tasks], cast(object, spec.seed)
    if spec.task_id not in ids:
        raise ConfigError(f"no task {spec.task_id!r} in {spec.protocol.id}; valid: {', '.join(ids)}")
    if not isinstance(seed, int) or seed < 0:
        raise ConfigError(f"TrialSpec.seed: expected an integer of at least 0, got {seed!r:.80}")


def _stopped(kind: str, message: str) -> Ended:
    """Return how a trial ends that the benchmark stops."""
    return Ended("safety_truncation", Failure(kind=kind, message=message))


def first_look(
    protocol: Protocol, *, task_id: str, seed: int, card: PolicyCard, weights: Path | None = None, salt: str = ""
) -> Observation:
    """Return the first observation of a trial, with the card's modalities and cameras; raises as a trial does."""
    spec = TrialSpec(protocol=protocol, task_id=task_id, seed=seed, policy=card.name, salt=salt)
    with Episode(spec, card=card, weights=weights) as episode:
        return episode.reset()
