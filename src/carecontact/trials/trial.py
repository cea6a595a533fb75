"""Run one trial: build, settle, let the policy act, keep everything the scorer needs."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.contract.action import Action, ActionBounds, check_action
from carecontact.contract.embodiment import EMBODIMENT
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard, Session
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.log import TrialLog
from carecontact.episode.perception import PerceptionLog
from carecontact.episode.prepare import settled_world
from carecontact.episode.randomization import sensor_noise
from carecontact.episode.vision import person_segmenter
from carecontact.errors import ActionError, PolicyError
from carecontact.hosting.conversation import PolicyConversation
from carecontact.hosting.opening import open_policy
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire import codec
from carecontact.observation.builder import ObservationBuilder, RawReadings
from carecontact.observation.keypoints import MediaPipePose
from carecontact.recording.schema import REGION_SEGMENT, REGIONS, SEGMENTS, EndReason, Failure, Header, Recording
from carecontact.recording.versions import package_versions
from carecontact.sim.close_up import render_close_up
from carecontact.sim.impedance import steps_of_period
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Samples, Settled, Simulation
from carecontact.trials.request import check_setup, setup_of
from carecontact.world.robot import panda_sha256

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Look:
    """One observation as the audit is shown it, after the policy has answered."""

    observation: Observation
    raw: RawReadings
    sent: bytes
    """The message in which the policy received it."""


@dataclass
class _Ended:
    reason: EndReason
    failure: Failure | None = None


@dataclass
class _Peak:
    """The moment to show in the report: largest force on the target, or on anything if the target was never touched."""

    force: float = 0.0
    on_target: bool = False
    time_s: float = 0.0
    segment: int = 0
    state: np.ndarray = field(default_factory=lambda: np.zeros(0))


def run_trial(
    spec: TrialSpec,
    *,
    policy: PolicySetup | None = None,
    weights: Path | None = None,
    prepare: Callable[[TrialSpec], tuple[Simulation, Settled, str]] | None = None,
    on_look: Callable[[Look], None] | None = None,
    on_policy: Callable[[bool], None] | None = None,
) -> Recording:
    """A policy's failure is part of the recording; what is raised is the harness's own (SceneError and its kin).

    Args:
        policy: how the trial's policy is reached; default: as its name in ``spec`` alone says.
        weights: folder with the weights of the protocol's segmenter.
        prepare: gives the world at t = 0, as ``settled_world`` does; the audit has its own.
        on_look: told after every answer what the policy was shown and what it was made of; nothing of it is kept here.
        on_policy: told True when the process of a local policy is about to start, False when it is gone.
    """
    started = time.monotonic()
    protocol = spec.protocol
    setup = policy or setup_of(spec)
    check_setup(spec, setup)
    if prepare is None:
        simulation, settled, model_sha256 = settled_world(protocol, task_id=spec.task_id, seed=spec.seed)
    else:
        simulation, settled, model_sha256 = prepare(spec)
    scene = simulation.scene
    settled_wall = time.monotonic()
    trial = _Trial(spec, simulation, settled, on_look)
    tell = on_policy if on_policy is not None and setup.ref.kind != "remote" else _tell_nobody
    with SceneRenderer(scene.model, protocol=protocol) as renderer:
        tell(True)
        card, ended = trial.run(renderer, setup, weights)
        tell(False)
        if trial.perception is not None:
            trial.log.extra |= trial.perception.arrays()
        # Before the report's own pictures, so that a trial whose policy has no camera is seen to render nothing for it.
        rendered = renderer.renders.copy()
        trial.add_report_frames(renderer)
        trial.log.extra["wall/seconds"] = np.array([settled_wall - started, time.monotonic() - settled_wall], "<f8")
        trial.log.extra["wall/renders"] = np.array(
            [rendered[k] for k in ("rgb", "depth", "robot_depth", "cell_depth", "truth")], "<f8"
        )
        trial.log.extra["wall/report_renders"] = np.array([(renderer.renders - rendered).total()], "<f8")
    header = Header(
        spec=spec, ended=ended.reason, failure=ended.failure,
        card=None if card is None else codec.encode_card(card),
        embodiment=EMBODIMENT, comfort_arm_deg=settled.comfort_arm_deg, segments=list(SEGMENTS), regions=list(REGIONS),
        human_joints=simulation.joint_names, pose_base_in_world=simulation.pose_base_in_world.tolist(),
        versions=package_versions(spec.protocol.vision.segmenter),
        sha256={
            "model": model_sha256, "protocol": protocol.sha256, "body": scene.body.sha256, "robot": panda_sha256()
        },
        solver_warnings=simulation.solver_warnings()
        + (["normal-force sensor full: normal sums are too small"] if simulation.normal_sum_truncated else []),
    )  # fmt: skip
    return Recording(header=header, arrays=trial.log.arrays())


def _tell_nobody(running: bool) -> None:
    pass


class _Trial:
    def __init__(
        self, spec: TrialSpec, simulation: Simulation, settled: Settled, on_look: Callable[[Look], None] | None
    ) -> None:
        self.spec, self.simulation, self.on_look = spec, simulation, on_look
        self.protocol: Protocol = spec.protocol
        self.task = self.protocol.task(spec.task_id)
        self.log = TrialLog(simulation, settled)
        self.perception: PerceptionLog | None = None
        self.peak = _Peak()
        self._cut_n = np.array([self.protocol.phases.truncation_over_pain * self.protocol.f_pain(s) for s in SEGMENTS])
        self._target = SEGMENTS.index(REGION_SEGMENT[self.task.region])

    def run(
        self, renderer: SceneRenderer, setup: PolicySetup, weights: Path | None
    ) -> tuple[PolicyCard | None, _Ended]:
        phases = self.protocol.phases
        card: PolicyCard | None = None
        self.simulation.start()
        self.log.add_state()
        try:
            with open_policy(
                setup, first_deadline_s=phases.first_call_deadline_s, deadline_s=phases.call_deadline_s
            ) as process:
                try:
                    card = process.start()
                    process.reset(self.task.prompt, self._session())
                    return card, self._act_loop(process, card, renderer, weights)
                finally:
                    # What it printed may hold times and paths, so it is evidence but no part of the recording's hash.
                    process.close()
                    self.log.extra["wall/policy_output"] = np.frombuffer(process.printed.encode(), "u1")
        except PolicyError as error:
            self._keep_last_notes(error)
            return card, _Ended("process_failure", Failure(kind=error.kind, message=str(error)))

    def _keep_last_notes(self, error: PolicyError) -> None:
        # Those of a step that failed are a courtesy; how it failed is what counts.
        with suppress(PolicyError):
            self.log.add_notes(error.notes, failed=True)

    def _act_loop(
        self, process: PolicyConversation, card: PolicyCard, renderer: SceneRenderer, weights: Path | None
    ) -> _Ended:
        simulation, impedance = self.simulation, self.protocol.impedance
        noise = sensor_noise(self.protocol, self.spec.seed, salt=self.spec.noise_salt)
        segmenter = person_segmenter(self.protocol, weights) if "masks" in card.modalities else None
        builder = ObservationBuilder(
            renderer, card, self.protocol, MediaPipePose(), noise=noise, segmenter=segmenter
        )  # fmt: skip
        self.perception = PerceptionLog(simulation.model, renderer)
        stiffness = (impedance.translational_n_m, impedance.rotational_nm_rad)
        limit_steps = round(self.protocol.phases.time_limit_s / self.protocol.physics.dt_s)
        periods = steps_of_period(card.control_hz, self.protocol.physics.dt_s)
        queue: deque[Action] = deque()
        done_steps = 0
        while done_steps < limit_steps:
            if not queue:
                simulation.refresh()
                observation = builder.build(simulation.data, instruction=self.task.prompt, sim_time_s=simulation.time_s)
                try:
                    reply = process.act(observation)
                except PolicyError:
                    # What it noted of this step is drawn over them.
                    self.log.add_frames(observation)
                    raise
                self.log.add_observation(observation, reply.sent_sha256)
                self.log.add_notes(reply.notes)
                self.perception.add(simulation.data, observation)
                if self.on_look is not None and builder.raw is not None:
                    self.on_look(Look(observation=observation, raw=builder.raw, sent=reply.sent))
                queue.extend(reply.actions)
            action = self._checked(queue.popleft())
            if action.stiffness is not None and action.stiffness != stiffness:
                stiffness = action.stiffness
                simulation.set_stiffness(*stiffness)
            self.log.add_action(action, stiffness)
            simulation.set_goal(action.pose_tcp_in_base, 1.0 / card.control_hz)
            steps = min(next(periods), limit_steps - done_steps)
            cut = self._advance(steps)
            done_steps += steps
            if cut is not None:
                return cut
            if action.done:
                return _Ended("done")
        return _Ended("time_limit")

    def _advance(self, steps: int) -> _Ended | None:
        """Run one action's period; returns why the trial is cut, if it is."""
        period = round(self.protocol.physics.target_period_s / self.protocol.physics.dt_s)
        while steps > 0:
            count = min(steps, period)
            samples = self.simulation.advance(count)
            steps -= count
            warnings = self.simulation.solver_warnings()
            if warnings:
                # What the period that diverged left in the sensors is no measurement, and may not be finite.
                return _Ended(
                    "safety_truncation", Failure(kind="solver", message=f"MuJoCo warning {', '.join(warnings)}")
                )
            self.log.add_samples(samples)
            force = np.concatenate([np.linalg.norm(s.force, axis=2) for s in samples])
            self._keep_peak(samples, force)
            over = force > self._cut_n
            if over.any():
                step, segment = np.argwhere(over)[0]
                message = f"{force[step, segment]:.0f} N on {SEGMENTS[segment]}, cut at {self._cut_n[segment]:.0f} N"
                return _Ended("safety_truncation", Failure(kind="force", message=message))
        return None

    def _keep_peak(self, samples: list[Samples], force: np.ndarray) -> None:
        best = force.max(0)
        on_target = bool(best[self._target] > 0)
        segment = self._target if on_target else int(best.argmax())
        better = best[segment] > self.peak.force if on_target == self.peak.on_target else on_target
        if best[segment] > 0 and better:
            self.peak = _Peak(
                force=float(best[segment]), on_target=on_target, time_s=self.simulation.time_s, segment=segment,
                state=self.simulation.integration_state(),
            )  # fmt: skip

    def _checked(self, action: Action) -> Action:
        try:
            return check_action(action, self._bounds())
        except ActionError as error:
            raise PolicyError("action", str(error)) from None

    def _bounds(self) -> ActionBounds:
        impedance = self.protocol.impedance
        return ActionBounds(
            workspace_low_m=impedance.workspace_low_m, workspace_high_m=impedance.workspace_high_m,
            translational_stiffness=impedance.translational_bounds, rotational_stiffness=impedance.rotational_bounds,
        )  # fmt: skip

    def _session(self) -> Session:
        joints = [self.simulation.model.joint(f"robot_joint{i}").range for i in range(1, 8)]
        return Session(
            action_bounds=self._bounds(), joint_low_rad=tuple(float(r[0]) for r in joints),
            joint_high_rad=tuple(float(r[1]) for r in joints),
            camera_sizes_px={name: (c.width, c.height) for name, c in self.protocol.cameras.items()},
            time_limit_s=self.protocol.phases.time_limit_s,
        )  # fmt: skip

    def add_report_frames(self, renderer: SceneRenderer) -> None:
        """Two pictures for the report: the room at the trial's end state of interest, and the contact close up."""
        data = mujoco.MjData(self.simulation.model)
        state = self.peak.state if self.peak.state.size else self.simulation.integration_state()
        mujoco.mj_setState(self.simulation.model, data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_forward(self.simulation.model, data)
        self.log.extra["report/snapshot_rgb"] = renderer.rgb(data, "exterior")
        self.log.extra["report/peak_rgb"] = render_close_up(
            renderer, self.simulation.scene, data, region=self.task.region
        )
        self.log.extra["report/peak_time_s"] = np.array([self.peak.time_s], "<f8")
