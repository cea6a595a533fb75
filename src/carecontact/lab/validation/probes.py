"""Four scripted sweeps in simulation: each score must follow the one property of a contact that it measures. It is not
enough that a score rises with a sweep, because in a deeper push the mean force rises with the peak. Each score is
therefore also compared with the same quantity, measured without the scorer's streams, and everything else in a trial is
the same over a sweep."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from typing import Literal

import numpy as np

from carecontact.human.skeleton import body_name
from carecontact.interface.geometry import matrix_from_quat, quat_from_matrix
from carecontact.lab.validation.result import Array, CheckResult, Figure, measured
from carecontact.lab.validation.rig import AnchorForce
from carecontact.lab.validation.subject import DOWN, Subject, axes, in_base, recording_of, surface_point
from carecontact.recording.schema import Recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.metric import METRICS, Metric
from carecontact.sim.simulation import Samples, Simulation

BENT = "left_hand_deviation"
"""The joint that is turned: a small torque takes it past either end, and it moves nothing into the robot's path."""
HOVER_M = 0.020
"""Height over the skin at which trials begin and end."""
TOUCHED_N = 0.5
"""Force from which the tissue counts as touched."""
PRESS_M, REST_S, TOP_S, RISE_S = 0.008, 1.0, 0.3, 0.3
"""Of a press: depth of the target before and after its deepest point, time at this depth, time at the deepest point,
and time of going there."""
TORQUE_RISE_S, TORQUE_HOLD_S, TOUCH_M, TOUCH_S = 0.8, 0.3, 0.012, 2.0
CYCLE_S, WAY_M, TURN_RAD = 1.8, 0.05, 0.3
SWING_M, SWING_HZ, SWING_S = 0.022, 1.0, 5.0
QUICK_S, AWAY_S = 0.1, 0.6


@dataclass(frozen=True, kw_only=True)
class Trial:
    recording: Recording
    known: float
    """The value that the score must have, measured along another path than the recording's or by other arithmetic."""
    held: Mapping[str, float]
    """Quantities that the sweep keeps the same, by name."""


Script = Callable[[Simulation, str, float], Trial]


class _Motion:
    """Moves the tool, pointing down, from target to target over the region; calls ``each`` after every physics step."""

    def __init__(self, simulation: Simulation, region: str, each: Callable[[], None] | None = None) -> None:
        self.simulation, self.region, self.each = simulation, region, each
        self.period_s = simulation.protocol.physics.target_period_s
        self.top = surface_point(simulation, region)
        self.along = axes(simulation, region)[0]
        self.samples: list[Samples] = []

    def go(self, depth_m: float, seconds: float, *, along_m: float = 0.0, turn_rad: float = 0.0) -> None:
        """Move the target to a depth under the skin, negative above it, turned about the tool's own axis."""
        spin = np.array([np.cos(turn_rad / 2), 0.0, 0.0, np.sin(turn_rad / 2)])
        quat = quat_from_matrix(matrix_from_quat(DOWN) @ matrix_from_quat(spin))
        place = in_base(self.simulation, self.top + along_m * self.along - [0.0, 0.0, depth_m])
        self.simulation.set_goal(np.r_[place, quat], seconds)
        self.wait(seconds)

    def wait(self, seconds: float) -> None:
        steps = round(seconds / self.simulation.model.opt.timestep)
        for chunk in [1] * steps if self.each else [steps]:
            self.samples += self.simulation.advance(chunk)
            if self.each:
                self.each()

    def trial(self, known: float, held: Mapping[str, float]) -> Trial:
        """Return the trial that ends here, whose duration the sweep keeps as well."""
        recording = recording_of(self.simulation, self.region, self.samples)
        return Trial(recording=recording, known=known, held={**held, "duration [s]": self.simulation.time_s})


class _Force:
    """Reads the force [N] that the region's springs and dampers exert on the bone, without contact sensors."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        self._read = AnchorForce(simulation, region)
        self._before = self._read()
        self.norms: list[float] = []

    def __call__(self) -> None:
        self.norms.append(float(np.linalg.norm(self._read() - self._before)))

    @property
    def touching(self) -> Array:
        norms = np.array(self.norms)
        return norms[norms >= TOUCHED_N]


def deeper_push(simulation: Simulation, region: str, depth_mm: float) -> Trial:
    """Rest on the skin, push once, briefly, to ``depth_mm``, and rest again.

    Rests and durations are the same at all levels, so that the push decides the peak and hardly affects the middle of
    the force.
    """
    force = _Force(simulation, region)
    motion = _Motion(simulation, region, force)
    for depth_m, rest_s in ((PRESS_M, REST_S), (depth_mm / 1000, TOP_S), (PRESS_M, REST_S)):
        motion.go(depth_m, RISE_S)
        motion.wait(rest_s)
    motion.go(-HOVER_M, AWAY_S)
    return motion.trial(max(force.norms), {"median force [N]": float(np.median(force.touching))})


def joint_turned(simulation: Simulation, region: str, torque_nm: float) -> Trial:
    """Touch in the same way at all levels, while a torque turns a distant joint toward an end stop and releases it.

    A positive torque turns it toward the upper end.
    """
    turned: list[float] = []
    force = _Force(simulation, region)
    dof = simulation.model.joint(f"human_{BENT}").dofadr[0]
    length = 2 * TORQUE_RISE_S + TORQUE_HOLD_S

    def each() -> None:
        turned.append(hand_margin(simulation))
        force()
        gone = simulation.time_s
        share = min(gone, length - gone, TORQUE_RISE_S) / TORQUE_RISE_S
        simulation.data.qfrc_applied[dof] = torque_nm * max(0.0, share)

    motion = _Motion(simulation, region, each)
    motion.go(TOUCH_M, RISE_S)
    motion.wait(TOUCH_S - RISE_S)
    motion.go(-HOVER_M, AWAY_S)
    return motion.trial(min(turned), {"peak force [N]": max(force.norms)})


def hand_margin(simulation: Simulation) -> float:
    """Return the margin [rad] of the left wrist's deviation to the declared ends of its range.

    It is computed from the orientation of the bones and not from a joint's coordinate: the axis of flexion, seen from
    the hand, turns about that of deviation.
    """
    flexion, deviation = (
        next(h for h in simulation.scene.hinges if h.name == name) for name in ("left_hand_flexion", BENT)
    )
    arm, hand = (simulation.data.body(body_name(s)).xmat.reshape(3, 3) for s in ("left_forearm", "left_hand"))
    axis = deviation.axis
    seen, bound = (v - (v @ axis) * axis for v in (hand.T @ arm @ flexion.axis, flexion.axis))
    angle = radians(deviation.bind_deg) + float(np.arctan2(np.cross(seen, bound) @ axis, seen @ bound))
    low, high = (radians(degrees) for degrees in deviation.range_deg)
    return min(angle - low, high - angle)


def stop_and_go(simulation: Simulation, region: str, pause_s: float) -> Trial:
    """Move and turn in the air, with a pause after each motion.

    A longer pause shortens the motion before it, so that all trials have the same duration and distance. It is in the
    air because dragged skin would creep on during a pause.
    """
    motion = _Motion(simulation, region)
    for along_m, turn_rad in ((WAY_M, 0.0), (WAY_M, TURN_RAD), (0.0, TURN_RAD), (0.0, 0.0)):
        motion.go(-HOVER_M, CYCLE_S - pause_s, along_m=along_m, turn_rad=turn_rad)
        motion.wait(pause_s)
    dt, limits = simulation.model.opt.timestep, simulation.protocol.contact
    speed, rotation = differentiated(np.concatenate([s.tcp_pose for s in motion.samples]), dt)
    active = (speed > limits.active_speed_m_s) | (rotation > limits.active_rotation_rad_s)
    return motion.trial(float(active.mean()), {"way [m]": float(speed.sum() * dt)})


def differentiated(pose: Array, dt_s: float) -> tuple[Array, Array]:
    """Return speed (T - 1,) [m/s] and rate of rotation (T - 1,) [rad/s] from each of the poses (T, 7) to the next."""
    before, after = pose[:-1, 3:], pose[1:, 3:]
    # A quaternion and its negative are the same rotation.
    after = after * np.where(np.einsum("ti,ti->t", before, after) < 0, -1.0, 1.0)[:, None]
    apart, along = np.linalg.norm(after - before, axis=1), np.linalg.norm(after + before, axis=1)
    return np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1) / dt_s, 4.0 * np.arctan2(apart, along) / dt_s


def swinging_force(simulation: Simulation, region: str, amplitude_mm: float) -> Trial:
    """Press with a target that oscillates about one depth.

    The tool is set down and lifted fast, so that the oscillation, and not press and release, decides how much the force
    fluctuates.
    """
    force = _Force(simulation, region)
    motion = _Motion(simulation, region, force)
    motion.go(SWING_M, QUICK_S)
    motion.wait(0.2)
    steps = round(SWING_S / motion.period_s)
    for k in range(steps):
        phase = 2 * np.pi * SWING_HZ * SWING_S * (k + 1) / steps
        motion.go(SWING_M + amplitude_mm / 1000 * np.sin(phase), motion.period_s)
    motion.go(-HOVER_M, QUICK_S)
    motion.wait(AWAY_S)
    return motion.trial(float(force.touching.std()), {"mean force [N]": float(force.touching.mean())})


HELD = 0.10
"""Share of its mean by which a quantity that a sweep keeps may still vary over the levels: a faster tool overshoots a
little more."""


@dataclass(frozen=True, kw_only=True)
class Probe:
    metric: str
    title: str
    level: str
    """The quantity that is swept, with its unit."""
    region: str
    levels: tuple[float, ...]
    """Increasing levels. On both sides of zero, the score must change from each level to the next one farther from
    zero."""
    direction: Literal[1, -1]
    """Sign of this change."""
    step: float
    """Least change from one level to the next, in the metric's unit."""
    known: str
    """The quantity that the score is compared with."""
    tolerance: float
    """Largest difference from that quantity, in the metric's unit."""
    script: Script


PROBES: Mapping[str, Probe] = {
    "C1@1": Probe(
        metric="C1@1", title="deeper push", level="commanded depth [mm]", region="forearm", direction=1, step=1.0,
        levels=(12.0, 20.0, 28.0, 36.0, 44.0),
        known="largest force in the tissue's springs", tolerance=0.2, script=deeper_push,
    ),
    "C2@1": Probe(
        metric="C2@1", title="joint past its ends", level="torque [N m]", region="abdomen", direction=-1, step=0.001,
        levels=(-5.5, -4.5, -3.5, -2.5, -1.5, 1.5, 2.5, 3.5, 4.5, 5.5),
        known="margin computed from the poses of the bones", tolerance=0.0005, script=joint_turned,
    ),
    "C4@1": Probe(
        metric="C4@1", title="stop and go", level="pause after each way [s]", region="forearm", direction=-1, step=0.04,
        levels=(0.4, 0.65, 0.9, 1.15, 1.4),
        known="share computed from differences of poses", tolerance=0.005, script=stop_and_go,
    ),
    "C5@1": Probe(
        metric="C5@1", title="swinging force", level="amplitude of depth [mm]", region="forearm", direction=1,
        step=0.15, levels=(2.0, 5.0, 8.0, 11.0, 14.0),
        known="spread of force in the tissue's springs", tolerance=0.05, script=swinging_force,
    ),
}  # fmt: skip
"""Metric -> its probe. C3 has none because it is a verdict and not a measurement; reports have sweeps of its gates."""


def sweep(subject: Subject, probe: Probe) -> list[Trial]:
    """Run one scripted trial for each level, each from the same settled state, as the scorer would receive it."""
    return [probe.script(subject.hovering(probe.region), probe.region, level) for level in probe.levels]


def judge(probe: Probe, trials: Sequence[Trial], metric: Metric) -> CheckResult:
    """Judge a sweep: at every level the score must equal the known quantity, every step must change it in the right
    direction and by enough, and the quantities that the sweep keeps must stay the same."""
    scores = [metric.compute(find_contact(trial.recording)) for trial in trials]
    values = np.array([np.nan if score is None else score for score in scores], np.float64)
    known = np.array([trial.known for trial in trials])
    least, direction = steps(probe, values).min(), "rises" if probe.direction > 0 else "falls"
    off, unit = np.abs(values - known).max(), metric.unit
    measures = [
        *(measured(f"{probe.level} {at:g}", value, unit) for at, value in zip(probe.levels, values, strict=True)),
        measured("levels with a score", np.isfinite(values).sum(), at_least=float(len(probe.levels))),
        measured(f"smallest step by which the score {direction}", least, unit, at_least=probe.step),
        measured(f"largest difference from the {probe.known}", off, unit, at_most=probe.tolerance),
    ]
    for name in trials[0].held:
        varies = spread(np.array([trial.held[name] for trial in trials]))
        measures.append(measured(f"kept the same: {name}, range over mean", varies, at_most=HELD))
    curves = {"scores": np.stack([np.array(probe.levels), values]), "known": known}
    title = f"{metric.title}: {probe.title}"
    return CheckResult(check=probe.metric, title=title, measures=tuple(measures), curves=curves)


def steps(probe: Probe, values: Array) -> Array:
    """Return the change (n,) in the wanted direction from each level to the next one farther from zero on its side."""
    levels = np.array(probe.levels)
    sides = [np.flatnonzero(levels >= 0), np.flatnonzero(levels < 0)[::-1]]
    return probe.direction * np.concatenate([np.diff(values[side]) for side in sides])


def spread(values: Array) -> float:
    return float(np.ptp(values) / np.abs(values).mean())


def run(subject: Subject, probe: Probe) -> CheckResult:
    return judge(probe, sweep(subject, probe), METRICS[probe.metric])


def draw(results: Sequence[CheckResult], figure: Figure) -> None:
    figure.set_size_inches(2.0 * len(results), 2.2)
    for panel, result in zip(np.atleast_1d(figure.subplots(1, len(results))), results, strict=True):
        probe = PROBES[result.check]
        level, score = result.curves["scores"]
        if "known" in result.curves:
            panel.plot(level, result.curves["known"], "s", ms=7, mfc="none", color="0.5", label="independent reference")
        for side in (level < 0, level >= 0):
            colour, label = "C0" if result.passed else "C1", "score" if side[-1] else None
            panel.plot(level[side], score[side], "o-", ms=4, color=colour, label=label)
        unit = {"rad": " [rad]", "N": " [N]"}.get(METRICS[result.check].unit, "")
        panel.set(xlabel=probe.level, ylabel=f"{result.check}{unit}", title=probe.title)
        if not result.passed:
            panel.text(0.5, 0.5, "failed", transform=panel.transAxes, ha="center", color="C1")
        panel.margins(y=0.08)
        if np.nanmin(score) > 0:
            panel.set_ylim(0, 1.1 * float(np.nanmax(score)))
    figure.axes[0].legend(loc="best")
