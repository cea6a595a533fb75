"""A recorded trial in motion again: its states at any time, by replaying the commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.episode.drivers import driver_of
from carecontact.episode.randomization import settled_world, under_control
from carecontact.errors import RecordingError, SceneError
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import CARTESIAN_IMPEDANCE, CONTROLS
from carecontact.recording.schema import Header, Recording
from carecontact.sim.simulation import Simulation
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256


def recorded_actions(recording: Recording) -> list[Action]:
    """Return the executed actions in their order, with the stiffness, damping and feedforward in force."""
    return [_action(recording.arrays, row) for row in range(len(recording["actions/time_s"]))]


def _action(arrays: Mapping[str, npt.NDArray[Any]], row: int) -> Action:
    def at(path: str) -> Any:
        """Return the entry of this action, None where nothing was commanded."""
        if path not in arrays or np.isnan(arrays[path][row]).any():
            return None
        return np.array(arrays[path][row])

    if "actions/joint" in arrays:
        return Action(joint=at("actions/joint"))
    stiffness, damping = at("actions/axis_stiffness"), at("actions/damping_ratio")
    if stiffness is None:
        stiffness = at("actions/stiffness")
    return Action(
        pose_tcp_in_base=at("actions/pose_tcp_in_base"),
        stiffness=None if stiffness is None else tuple(stiffness.tolist()),
        damping_ratio=None if damping is None else float(damping),
        wrench_in_tcp=at("actions/wrench_in_tcp"),
    )


# The states of a recorded trial at any time.
#
# A recording holds a state for each second. Between two of them, the trial is stepped again with the recorded actions,
# and what it lands on is compared with the next stored state, bit for bit. On another processor, or with another build
# of the tissue, the last bits may differ; then each second begins from its stored state again. If that still leaves the
# recorded path of the tool by more than ``CLOSE_M``, the states in between are interpolated.

F64 = npt.NDArray[np.float64]
Kind = Literal["exact", "close", "interpolated"]

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
CLOSE_M = 5e-4
"""Largest distance of the tool from its recorded path at which stepped states are still shown (assumed: a fifth of a
pixel in a view of the whole room)."""


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """The states to show between two states that the recording stores."""

    steps: npt.NDArray[np.int64]
    """(n,) physics steps since t = 0"""
    states: F64
    """(n, size) integration states"""
    kind: Kind
    """How they were found: stepped onto the next stored state to the last bit, stepped close to it, or interpolated."""
    off_m: float
    """Largest distance of the tool from its recorded path."""


KIND_TEXTS: dict[Kind, str] = {
    "exact": "Stepped again from the recording, bit for bit",
    "close": "Stepped again from the state of each second",
    "interpolated": "Interpolated between the states of each second",
}
"""How each kind is described to the user, from the best to the worst."""


@dataclass(kw_only=True)
class ReplayQuality:
    """How the states of a whole trial were found, summed up over its stretches."""

    kind: Kind = "exact"
    """The worst kind among all stretches."""
    off_m: float = 0.0
    """Largest distance of the tool from its recorded path."""

    def take(self, stretch: Stretch) -> None:
        self.kind = max(self.kind, stretch.kind, key=list(KIND_TEXTS).index)
        self.off_m = max(self.off_m, stretch.off_m)

    def __str__(self) -> str:
        text = KIND_TEXTS[self.kind][0].lower() + KIND_TEXTS[self.kind][1:]
        off = f", at most {1000 * self.off_m:.2f} mm off the tool's recorded path"
        return text if self.kind == "exact" else text + off


class Replay:
    """One recorded trial in a world that was built again."""

    def __init__(self, recording: Recording) -> None:
        """Build the world at t = 0. Raises RecordingError for a trial that ended before, or whose world differs."""
        header, self.recording = recording.header, recording
        self.title = header.spec.trial_id
        self.dt_s = header.spec.protocol.physics.dt_s
        self.stored: F64 = recording["state/integration"]
        self.step_count = len(recording["scorer/time_s"])
        if not len(self.stored) or not self.step_count:
            raise RecordingError(f"{self.title}: the trial ended before t = 0, so there is nothing to show")
        self.simulation = _world(header)
        self.scene, self.model = self.simulation.scene, self.simulation.model
        size = mujoco.mj_stateSize(self.model, STATE)
        if self.stored.shape[1] != size:
            sizes = f"its states have {self.stored.shape[1]} numbers, this world's {size}"
            raise RecordingError(_foreign(header, sizes))
        self._probe = mujoco.MjData(self.model)
        self._tcp = self.model.site(self.scene.robot.tcp_site).id
        self._stored_steps = self._steps(recording["state/time_s"])

    def _steps(self, time_s: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        return np.round(time_s / self.dt_s).astype(np.int64)

    def stretches(self, fps: float) -> Iterator[Stretch]:
        """All states at a rate [1/s], from t = 0 to the trial's end. Call it once."""
        count = int(self.step_count * self.dt_s * fps + 1e-9) + 1
        shown = np.minimum(self._steps(np.arange(count) / fps), self.step_count)
        run = _Run(self.simulation, self.recording, self._steps)
        run.correct(self.stored[0])
        for k, begin in enumerate(self._stored_steps):
            last = k + 1 == len(self._stored_steps)
            end = self.step_count if last else int(self._stored_steps[k + 1])
            mine = shown[(shown >= begin) & ((shown <= end) if last else (shown < end))]
            yield self._stretch(run, k, mine, end)

    def _stretch(self, run: _Run, k: int, steps: npt.NDArray[np.int64], end: int) -> Stretch:
        following = self.stored[k + 1] if k + 1 < len(self.stored) else None
        states = np.empty((len(steps), self.stored.shape[1]))
        for row, step in enumerate(steps):
            states[row] = run.go(int(step))
        landed = run.go(end)
        path = self.recording["scorer/pose_tcp_in_world"][:, :3]
        on_path = [(state, path[step]) for state, step in zip(states, steps, strict=True) if step < len(path)]
        off_m = max((self._distance(state, place) for state, place in on_path), default=0.0)
        exact = np.array_equal(landed, following, equal_nan=True) if following is not None else off_m < 1e-6
        if following is not None and not exact:
            run.correct(following)
            off_m = max(off_m, self._distance(landed, self._place(following)))
        kind: Kind = "exact" if exact else "close" if off_m <= CLOSE_M else "interpolated"
        if kind == "interpolated" and following is not None:
            share = (steps - self._stored_steps[k]) / (end - self._stored_steps[k])
            states = np.array([self._between(self.stored[k], following, float(s)) for s in share])
        return Stretch(steps=steps, states=states, kind=kind, off_m=off_m)

    def _distance(self, state: F64, place: npt.NDArray[Any]) -> float:
        return float(np.linalg.norm(self._place(state) - place))

    def _place(self, state: F64) -> F64:
        mujoco.mj_setState(self.model, self._probe, state, STATE)
        mujoco.mj_kinematics(self.model, self._probe)
        return self._probe.site_xpos[self._tcp].copy()

    def _between(self, a: F64, b: F64, share: float) -> F64:
        """Interpolate between two states: rotations along the shortest path, all other numbers linearly."""
        model, probe, way = self.model, self._probe, np.zeros(self.model.nv)
        qpos = []
        for state in (a, b):
            mujoco.mj_setState(model, probe, state, STATE)
            qpos.append(probe.qpos.copy())
        mujoco.mj_differentiatePos(model, way, 1.0, qpos[0], qpos[1])
        mujoco.mj_integratePos(model, qpos[0], way, share)
        mujoco.mj_setState(model, probe, (1 - share) * a + share * b, STATE)
        probe.qpos[:] = qpos[0]
        out = np.empty_like(a)
        mujoco.mj_getState(model, probe, out, STATE)
        return out


class _Run:
    """A simulation under the recorded commands."""

    def __init__(self, simulation: Simulation, recording: Recording, steps_of: Any) -> None:
        self._simulation = simulation
        self._actions = recorded_actions(recording)
        self._action_steps = steps_of(recording["actions/time_s"])
        self._look_steps = set(steps_of(recording["policy/observation_time_s"]).tolist())
        card = recording.header.card
        self._period_s = 1.0 / float(card["control_hz"]) if card else 0.0
        self._driver = None
        if card and self._actions:
            space, control = card["action_space"], recording.header.control or CARTESIAN_IMPEDANCE
            self._driver = driver_of(PolicyCard(name="recorded", action_space=space, control=control), simulation)
        self._at, self._next = 0, 0
        simulation.start()

    def correct(self, state: F64) -> None:
        """Take over a stored state. The commands in force stay; a state that is equal already changes nothing."""
        if not np.array_equal(self._simulation.integration_state(), state, equal_nan=True):
            mujoco.mj_setState(self._simulation.model, self._simulation.data, state, STATE)
            self._simulation.refresh()

    def go(self, step: int) -> F64:
        """Return the integration state at a step, which is not before the last one's."""
        due = sorted({*self._look_steps, *self._action_steps.tolist(), step})
        for end in (d for d in due if self._at < d <= step):
            # As the episode did at this step: an observation brings poses up to date, then the action begins.
            if self._at in self._look_steps:
                self._simulation.refresh()
            while self._next < len(self._actions) and self._action_steps[self._next] <= self._at:
                assert self._driver is not None
                self._driver.apply(self._actions[self._next], self._period_s)
                self._next += 1
            self._simulation.advance(end - self._at)
            self._at = end
        return self._simulation.integration_state()


def _world(header: Header) -> Simulation:
    spec = header.spec.opened
    if spec.salt_sha256:
        raise RecordingError(
            f"{spec.trial_id}: its person was drawn with a secret of which the recording holds the hash only, so that "
            "its world cannot be built again"
        )
    try:
        simulation, _, _ = settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)
    except SceneError as error:
        raise RecordingError(_foreign(header, str(error))) from None
    control = None if header.control is None else CONTROLS[header.control]
    if control is not None and control.joint is not None:
        simulation, _ = under_control(simulation, control)
    return simulation


def _foreign(header: Header, why: str) -> str:
    """Return the message, in one line, about a recording that this release cannot show."""
    recorded = header.sha256.get("kernel", "none")
    here = kernel_sha256()
    tissue = "" if recorded == here else f" and with another tissue kernel ({recorded[:12]}; installed: {here[:12]})"
    return (
        f"{header.spec.trial_id}: recorded by carecontact {header.versions.get('carecontact', 'unknown')}{tissue}, "
        f"whose world this installation cannot build again: {why}; install the release that recorded it"
    )
