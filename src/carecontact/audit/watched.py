"""Runs the audit's trials through the product's own ``run_trial`` and keeps a raw log beside them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.audit.keyframe import CONTROL_HZ
from carecontact.audit.raw_log import Meta, write_look, write_meta
from carecontact.audit.state import StateReader
from carecontact.contract.embodiment import Baked
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import like
from carecontact.episode.randomization import calibration
from carecontact.errors import CarecontactError
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire import codec
from carecontact.hosting.witness import TASK, TOLD
from carecontact.recording.schema import Recording
from carecontact.sim.simulation import Settled, Simulation
from carecontact.trials.trial import Look, run_trial

Prepare = Callable[[TrialSpec], tuple[Simulation, Settled, str]]

MAX_KEPT_BYTES = 200_000_000
"""Most bytes of one trial's messages that are kept and logged: about 20 observations of all modalities. A policy that
looks at every step would otherwise fill memory and disk. Without images, no trial comes near this bound."""
WITNESS = "audit_witness:witness"
_WITNESS_SOURCE = """
from pathlib import Path
from carecontact.hosting.witness import Witness

def witness():
    return Witness(Path(__file__).parent)
"""


@dataclass(frozen=True, kw_only=True)
class Message:
    time_s: float
    sent: bytes


@dataclass(kw_only=True)
class Watched:
    """One audited trial."""

    policy: str
    """Name of the policy whose card was shown."""
    task_id: str
    joints: int
    """Number of the robot's joints."""
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
    told: dict[str, Any] = field(default_factory=dict[str, Any])
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
        """Return what the trial was, and how many of its observations the audit saw."""
        return {
            "policy": self.policy, "task": self.task_id, "observations": len(self.look_times_s),
            "recomputed": self.kept, "in_contact": self.looks_in_contact,
            "ended": None if self.recording is None else self.recording.header.ended, "error": self.error,
        }  # fmt: skip

    def forget(self) -> None:
        """Free the memory of the observations and keep their times."""
        self.looks.clear()
        self.sent.clear()


def watch(
    spec: TrialSpec, *, policy: str, prepare: Prepare, log: Path | None = None, setup: PolicySetup | None = None
) -> Watched:
    """Run one trial and keep what it showed; with ``log`` also on disk. A failure is kept in ``error``, never raised.

    ``setup``: how to start or reach the policy; by default, the policy's name in ``spec`` decides.
    """
    task, robot = spec.protocol.task(spec.task_id), spec.protocol.scene.robot
    watched = Watched(policy=policy, task_id=task.id, instruction=task.prompt, joints=len(robot.joints))
    readers: list[StateReader] = []
    drawn: list[Protocol] = []
    kept = 0

    def prepared(spec: TrialSpec) -> tuple[Simulation, Settled, str]:
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
        if kept > MAX_KEPT_BYTES:
            return
        watched.kept += 1
        watched.looks.append(Message(time_s=time_s, sent=look.sent))
        if log is not None:
            write_look(log, number, observation=look.observation, raw=look.raw, sent=look.sent, state=state)

    try:
        recording = watched.recording = run_trial(
            spec, policy=setup, prepare=prepared, on_look=on_look, on_sent=on_sent
        )
    except CarecontactError as error:
        watched.error = str(error)
        return watched
    failure = recording.header.failure
    if recording.header.ended == "process_failure" and failure is not None:
        watched.error = failure.message
    card = watched.card
    protocol = like(spec.protocol, drawn[-1]) if drawn else spec.protocol
    if log is not None and watched.looks and card is not None:
        scene, robot, known = (
            protocol.scene,
            protocol.scene.robot,
            calibration(spec.protocol, spec.seed, salt=spec.salt),
        )
        write_meta(
            log,
            Meta(
                policy=policy, instruction=watched.instruction, arguments=dict(card.arguments),
                modalities=card.modalities, cameras=card.cameras,
                tcp_in_hand_m=(0.0, 0.0, robot.tcp_z_m),
                calibration={name: error.tolist() for name, error in known.items()},
                cell={
                    "arm": robot.source.name if isinstance(robot.source, Baked) else "",
                    "robot_base_m": scene.robot_base_m, "robot_yaw_deg": scene.robot_yaw_deg,
                    "cameras": {name: camera.model_dump() for name, camera in protocol.cameras.items()},
                },
            ),
            spec,
        )  # fmt: skip
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

    ``folder``: where the witness's process finds its task and writes what it was told. Trials that are to be compared
    must have the same folder, since its path reaches the policy.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{WITNESS.partition(':')[0]}.py").write_text(_WITNESS_SOURCE)
    task = {
        "card": codec.encode_card(card), "control_hz": CONTROL_HZ, "poses": poses.tolist(),
        "actions_per_look": actions_per_look,
    }  # fmt: skip
    (folder / TASK).write_text(json.dumps(task))
    told = folder / TOLD
    told.unlink(missing_ok=True)
    watched = watch(
        spec.model_copy(update={"policy": WITNESS}),
        policy=card.name, prepare=prepare, log=log,
        setup=replace(PolicySetup.of(WITNESS, search_path=[str(folder)]), writable=(str(folder),)),
    )  # fmt: skip
    if told.is_file():
        watched.told = json.loads(told.read_text())
    return watched
