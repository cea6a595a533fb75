"""Runs the audit's trials from settled worlds through the product's own ``run_trial``, and keeps a raw log beside
them."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.audit.raw_log import Meta, WorldState, write_foam, write_look, write_meta
from carecontact.episode.randomization import World, calibration, draw, settled_world, with_draws_of
from carecontact.errors import CarecontactError, SceneError
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Baked, Robot
from carecontact.lab.validation.subject import skin_points
from carecontact.policies.motion import UP, Leg, radial_quat, sample, travel
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.schema import Recording
from carecontact.running.trial import Look, run_trial
from carecontact.scoring.foam import RecordedWiping
from carecontact.serving import codec
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.witness import RECEIVED_FILE, TASK
from carecontact.sim.simulation import Simulation
from carecontact.tissue.plugin import set_law

DRAWN = int(
    mujoco.mjtState.mjSTATE_TIME | mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)  # fmt: skip
"""The parts of MuJoCo's integration state that pictures depend on. The sensor history, a hundred times as long, is not
among them."""


class StateReader:
    """Reads one simulation through MuJoCo's own interface, without any code that makes observations. It must be made at
    t = 0, from which it counts steps."""

    def __init__(self, simulation: Simulation) -> None:
        self._model, self._data = simulation.model, simulation.data
        self._begin_s = float(self._data.time)
        self._qpos, self._dof = robot_addresses(self._model, simulation.robot)

    def read(self) -> WorldState:
        vector = np.zeros(mujoco.mj_stateSize(self._model, DRAWN))
        mujoco.mj_getState(self._model, self._data, vector, DRAWN)
        return WorldState(
            # MuJoCo's clock accumulates rounding errors, which stay far below one step in any trial.
            steps=round((float(self._data.time) - self._begin_s) / self._model.opt.timestep),
            joint_position=self._data.qpos[self._qpos].copy(), joint_velocity=self._data.qvel[self._dof].copy(),
            vector=vector,
        )  # fmt: skip


def robot_addresses(model: mujoco.MjModel, robot: Robot) -> tuple[list[int], list[int]]:
    joints = [model.joint(name) for name in robot.joints]
    return [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]


F64 = npt.NDArray[np.float64]

CONTROL_HZ = 20.0
PRESS_DEPTH_M = 0.020
"""Commanded depth [m] below the skin; at the default 400 N/m it limits the force to 8 N."""
CLEARANCE_M = 0.20
"""Height [m] over the skin on the way to the press."""
PRESS_SPEED_M_S = 0.06
BEFORE_S, AFTER_S = 0.30, 0.45
"""How long [s] before the first contact the later keyframe lies, and how much [s] of the press follows that contact."""
ATTEMPTS = 5
NEAR_MIDDLE_M = 0.02
STIFFER = 2.0


class Keyframe:
    """One settled world of a task and seed. All trials that begin from it begin from the same bits."""

    def __init__(self, protocol: Protocol, *, task_id: str, seed: int, salt: str = "") -> None:
        """Build the world, let the person settle, and press once."""
        simulation, self.settled, self.model_sha256 = settled_world(protocol, task_id=task_id, seed=seed, salt=salt)
        self._task_id = task_id
        region = protocol.task(task_id).region
        self.laid_at_deg = draw(protocol, region=region, seed=seed, salt=salt).comfort_arm_deg
        """Angle [deg] at which the person's arm was laid."""
        self.scene = simulation.scene
        self._parked = simulation.integration_state()
        self.parked_pose = simulation.control.target_in_base
        """(7,) pose of the tool centre point in the robot's base; a robot that is given it as target stays where it
        is."""
        self._near, self.poses = self._approach(simulation, region=region)
        """(n, 7) poses of the tool centre point in the robot's base at CONTROL_HZ: they begin at the later keyframe and
        end in contact."""

    def parked(self, spec: TrialSpec) -> World:
        """Return the world with the robot parked; give this method to ``run_trial`` as ``prepare``."""
        if spec.task_id != self._task_id:
            # Another task has its own foam on the same person.
            return settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)
        return self._begin(Simulation(self.scene), self._parked)

    def near(self, spec: TrialSpec) -> World:
        """Return the world with the tool BEFORE_S before its first contact; also for ``prepare``."""
        return self._begin(Simulation(self.scene), self._near)

    def twin(self, spec: TrialSpec) -> World:
        """Return the same moment in a world with the hidden values of ``spec`` and stiffer tissue. It moves like the
        other world until contact, because tissue that nothing touches has no effect."""
        scene = replace(
            self.scene,
            model=copy.deepcopy(self.scene.model),
            protocol=with_draws_of(spec.protocol, self.scene.protocol),
        )
        for name, region in scene.regions.items():
            law = region.tissue.model_dump()
            stiffer = {field: STIFFER * law[field] for field in ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3")}
            set_law(scene.model, name, region.tissue.model_copy(update=stiffer))
        return self._begin(Simulation(scene), self._near)

    def _begin(self, simulation: Simulation, state: F64) -> World:
        simulation.restore(state, comfort_arm_deg=self.laid_at_deg)
        return simulation, self.settled, self.model_sha256

    def _approach(self, simulation: Simulation, *, region: str) -> tuple[F64, F64]:
        """Return the state BEFORE_S before first contact and the poses (n, 7) that follow it. If the person has moved
        meanwhile, the press is aimed again."""
        simulation.start()
        steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
        back, ahead = round(BEFORE_S * CONTROL_HZ), round(AFTER_S * CONTROL_HZ)
        states, done = [simulation.integration_state()], list[F64]()
        for _ in range(ATTEMPTS):
            poses = _press(simulation, region)
            for k, pose in enumerate(poses):
                simulation.set_goal(pose, 1 / CONTROL_HZ)
                if any(samples.force.any() for samples in simulation.advance(steps)):
                    at = len(done) + k
                    first = max(at - back, 0)
                    # A robot that came late may touch near the end of its way, and then stays there.
                    stays = np.repeat(poses[-1:], ahead, 0)
                    return states[-1 - (at - first)], np.array([*done, *poses, *stays])[first : at + 1 + ahead]
                states = [*states[-back:], simulation.integration_state()]
            done += list(poses)
        raise SceneError(f"the audit's press does not touch the {region} in {ATTEMPTS} attempts")


def _press(simulation: Simulation, region: str) -> F64:
    """Return poses (n, 7) of the tool in the robot's base at CONTROL_HZ, from where it is to a press on the region."""
    simulation.refresh()
    base = simulation.encoders.in_base(simulation.data, _skin_in_world(simulation, region), np.eye(3))
    skin, start = base[:3, 3], simulation.control.target_in_base
    press = Leg(points=(skin - PRESS_DEPTH_M * UP)[None], quat_wxyz=radial_quat(skin), speed_m_s=PRESS_SPEED_M_S)
    above = replace(press, points=(skin + 0.02 * UP)[None], speed_m_s=5 * PRESS_SPEED_M_S)
    hold = replace(press, hold_s=AFTER_S)
    legs = travel(start, [above, hold], travel_height_m=float(skin[2]) + CLEARANCE_M)[:-1]
    return np.array(list(sample(legs, start)))


def _skin_in_world(simulation: Simulation, region: str) -> F64:
    """Return the highest place (3,) [m] of the shell near the middle; the hand does not touch a large chest there."""
    vertices = skin_points(simulation, region)
    middle = simulation.data.site(f"region_{region}").xpos
    near = np.linalg.norm(vertices[:, :2] - middle[:2], axis=1) < NEAR_MIDDLE_M
    return np.array([*middle[:2], vertices[near, 2].max()])


Prepare = Callable[[TrialSpec], World]

MAX_KEPT_BYTES = 200_000_000
"""Most bytes of one trial's messages that are kept and logged: about 20 observations of all modalities. A policy that
looks at every step would otherwise fill memory and disk. Without images, no trial comes near this bound."""
WITNESS = "audit_witness:witness"
_WITNESS_SOURCE = """
from pathlib import Path
from carecontact.serving.witness import Witness

def witness():
    return Witness(Path(__file__).parent)
"""


@dataclass(frozen=True, kw_only=True)
class Message:
    time_s: float
    sent: bytes
    asked: tuple[str, ...] = ()
    """Cameras that the actions since the observation before named."""


@dataclass(kw_only=True)
class Watched:
    policy: str
    """Name of the policy whose card was shown."""
    task_id: str
    joints: int
    recording: Recording | None = None
    error: str | None = None
    """Why the harness could not run the trial, or why the policy's process failed; None if neither happened."""
    looks: list[Message] = field(default_factory=list["Message"])
    """The observations in the first MAX_KEPT_BYTES; ``forget`` frees them."""
    kept: int = 0
    """How many of the observations are or were in ``looks``, and so in the log."""
    sent: list[bytes] = field(default_factory=list[bytes])
    """Every message that was sent to the policy, in order; those beyond MAX_KEPT_BYTES are empty."""
    instruction: str = ""
    look_steps: list[int] = field(default_factory=list[int])
    """Number of physics steps before each observation, by the simulator's own clock; it covers all observations."""
    look_times_s: list[float] = field(default_factory=list[float])
    """Time of each observation, as it was sent."""
    received: dict[str, Any] = field(default_factory=dict[str, Any])
    """Everything that had reached the process of a witness by the time of its reset."""

    @property
    def card(self) -> PolicyCard | None:
        shown = None if self.recording is None else self.recording.header.card
        return None if shown is None else codec.decode_card(dict(shown))

    @property
    def force_n(self) -> npt.NDArray[np.float64]:
        """(T,) largest force [N] on any segment at each step."""
        if self.recording is None:
            return np.zeros(0)
        return np.linalg.norm(self.recording["scorer/force_human_from_robot_in_world"], axis=2).max(1, initial=0.0)

    @property
    def looks_in_contact(self) -> int:
        """Number of observations that came right after a step with contact."""
        if self.recording is None:
            return 0
        force_n = self.force_n
        return sum(0 < steps <= len(force_n) and bool(force_n[steps - 1]) for steps in self.look_steps)

    def as_json(self) -> dict[str, Any]:
        return {
            "policy": self.policy, "task": self.task_id, "observations": len(self.look_times_s),
            "recomputed": self.kept, "in_contact": self.looks_in_contact,
            "ended": None if self.recording is None else self.recording.header.ended, "error": self.error,
        }  # fmt: skip

    def forget(self) -> None:
        self.looks.clear()
        self.sent.clear()


def watch(
    spec: TrialSpec, *, policy: str, prepare: Prepare, log: Path | None = None, setup: PolicySetup | None = None
) -> Watched:
    """Run one trial and keep what it showed, with ``log`` also on disk. A failure is kept in ``error``."""
    task, robot = spec.protocol.task(spec.task_id), spec.protocol.scene.robot
    watched = Watched(policy=policy, task_id=task.id, instruction=task.prompt, joints=len(robot.joints))
    readers: list[StateReader] = []
    drawn: list[Protocol] = []
    kept, asked = 0, set[str]()

    def prepared(spec: TrialSpec) -> World:
        world = prepare(spec)
        readers.append(StateReader(world[0]))
        drawn.append(world[0].protocol)
        return world

    def on_sent(message: bytes) -> None:
        # The same object is stored in its look, so that no second copy is needed.
        watched.sent.append(message if kept + len(message) <= MAX_KEPT_BYTES else b"")

    def on_look(look: Look) -> None:
        nonlocal kept
        state, time_s, number = readers[-1].read(), look.observation.sim_time_s, len(watched.look_times_s)
        watched.look_times_s.append(time_s)
        watched.look_steps.append(state.steps)
        kept += len(look.sent)
        wanted = tuple(sorted(asked))
        asked.clear()
        asked.update(name for action in look.actions for name in action.look)
        if kept > MAX_KEPT_BYTES:
            return
        watched.kept += 1
        watched.looks.append(Message(time_s=time_s, sent=look.sent, asked=wanted))
        if log is not None:
            write_look(log, number, observation=look.observation, raw=look.raw, sent=look.sent, state=state)

    try:
        recording = run_trial(spec, policy=setup, prepare=prepared, on_look=on_look, on_sent=on_sent)
    except CarecontactError as error:
        watched.error = str(error)
        return watched
    watched.recording, failure = recording, recording.header.failure
    if recording.header.ended == "process_failure" and failure is not None:
        watched.error = failure.message
    card, protocol = watched.card, with_draws_of(spec.protocol, drawn[-1]) if drawn else spec.protocol
    if log is None or not watched.looks or card is None:
        return watched
    scene, robot = protocol.scene, protocol.scene.robot
    known = calibration(spec.protocol, spec.seed, salt=spec.salt)
    cell = {
        "arm": robot.source.name if isinstance(robot.source, Baked) else "",
        "robot_base_m": scene.robot_base_m,
        "robot_yaw_deg": scene.robot_yaw_deg,
        "cameras": {name: camera.model_dump() for name, camera in protocol.cameras.items()},
    }
    meta = Meta(
        policy=policy,
        instruction=watched.instruction,
        modalities=card.modalities,
        cameras=card.cameras,
        tcp_in_hand_m=(0.0, 0.0, robot.tcp_z_m),
        cell=cell,
        calibration={name: error.tolist() for name, error in known.items()},
        arguments=dict(card.arguments),
    )
    write_meta(log, meta, spec)
    # From the recording, and not from what the trial painted, so that redrawing finds where the two differ.
    if (foam := RecordedWiping.of(recording)) is not None:
        write_foam(log, np.array([foam.until(time_s).left for time_s in watched.look_times_s]))
    return watched


def press(
    spec: TrialSpec,
    *,
    card: PolicyCard,
    poses: npt.NDArray[np.float64],
    prepare: Prepare,
    actions_per_look: int,
    folder: Path,
    log: Path | None = None,
) -> Watched:
    """Run a trial of the witness, which requests the card's modalities and plays poses (n, 7) at CONTROL_HZ.

    ``folder``: where the witness's process finds its task and writes what it received. Trials that are to be compared
    must have the same folder, since its path reaches the policy.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{WITNESS.partition(':')[0]}.py").write_text(_WITNESS_SOURCE)
    task = {"card": codec.encode_card(card), "poses": poses.tolist()}
    task |= {"control_hz": CONTROL_HZ, "actions_per_look": actions_per_look}
    (folder / TASK).write_text(json.dumps(task))
    received = folder / RECEIVED_FILE
    received.unlink(missing_ok=True)
    setup = replace(PolicySetup.of(WITNESS, search_path=[str(folder)]), writable=(str(folder),))
    spec = spec.model_copy(update={"policy": WITNESS})
    watched = watch(spec, policy=card.name, prepare=prepare, log=log, setup=setup)
    if received.is_file():
        watched.received = json.loads(received.read_text())
    return watched
