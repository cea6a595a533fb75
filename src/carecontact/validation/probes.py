"""Four scripted sweeps in simulation: each score must follow the one thing about a contact that it is a score of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from carecontact.recording.schema import Recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metric import METRICS, Metric
from carecontact.sim.simulation import Samples, Simulation
from carecontact.validation.moves import DOWN, PRESS, Behaviour, in_base, perform, surface_point
from carecontact.validation.result import CheckResult, Measure
from carecontact.validation.scores import recording_of
from carecontact.validation.subject import Subject

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

SUPINATION = "left_forearm_supination"
"""Turns without moving anything into the robot's way."""
SWING_M, SWING_HZ, SWING_S = 0.018, 1.0, 3.0


@dataclass(frozen=True, kw_only=True)
class Probe:
    metric: str
    title: str
    level: str
    """What is swept, with its unit."""
    region: str
    levels: tuple[float, ...]
    direction: Literal[1, -1]
    """Sign of the change that the score must show from each level to the next."""
    script: Callable[[Simulation, str, float], Sequence[Samples]]


def _press(simulation: Simulation, region: str, depth_mm: float) -> Sequence[Samples]:
    behaviour = Behaviour(name="press", overtravel_m=depth_mm / 1000, hold_s=PRESS.hold_s)
    return perform(simulation, region, behaviour).samples


def _twist(simulation: Simulation, region: str, torque_nm: float) -> Sequence[Samples]:
    """A touch on the belly while a torque turns the other forearm toward, and past, its end stop."""
    dof = simulation.model.joint(f"human_{SUPINATION}").dofadr[0]
    simulation.data.qfrc_applied[dof] = torque_nm
    return perform(simulation, region, Behaviour(name="touch", overtravel_m=0.012, hold_s=1.0)).samples


def _stop_and_go(simulation: Simulation, region: str, pause_s: float) -> Sequence[Samples]:
    # A tool that drags soft skin creeps on for most of a second after its target stopped: shorter pauses are none.
    behaviour = Behaviour(
        name="scrub", overtravel_m=0.018, half_stroke_m=0.030, strokes=2, speed_m_s=0.10, pause_s=pause_s, hold_s=0.1
    )
    return perform(simulation, region, behaviour).samples


def _swing(simulation: Simulation, region: str, amplitude_mm: float) -> Sequence[Samples]:
    """A press whose target goes up and down about one depth."""
    top = surface_point(simulation, region)
    period = round(simulation.protocol.physics.target_period_s / simulation.model.opt.timestep)
    samples: list[Samples] = []

    def go(depth_m: float, seconds: float) -> None:
        simulation.set_goal(np.r_[in_base(simulation, top - [0, 0, depth_m]), DOWN], seconds)
        for _ in range(round(seconds / simulation.protocol.physics.target_period_s)):
            samples.extend(simulation.advance(period))

    go(SWING_M, 1.0)
    steps = round(SWING_S / simulation.protocol.physics.target_period_s)
    for k in range(steps):
        phase = 2 * np.pi * SWING_HZ * SWING_S * (k + 1) / steps
        go(SWING_M + amplitude_mm / 1000 * np.sin(phase), simulation.protocol.physics.target_period_s)
    go(-0.02, 0.8)
    return samples


PROBES: Mapping[str, Probe] = {
    probe.metric: probe
    for probe in (
        Probe(metric="C1@1", title="deeper push", level="commanded depth [mm]", region="forearm",
              levels=(8.0, 13.0, 18.0, 23.0, 28.0, 33.0), direction=1, script=_press),
        Probe(metric="C2@1", title="joint turned past its end", level="torque [N m]", region="abdomen",
              levels=(0.0, 0.6, 1.2, 1.8, 2.4, 3.0), direction=-1, script=_twist),
        Probe(metric="C4@1", title="stop and go", level="pause at each turn [s]", region="forearm",
              levels=(0.4, 0.8, 1.2, 1.6, 2.0), direction=-1, script=_stop_and_go),
        Probe(metric="C5@1", title="swinging force", level="amplitude of depth [mm]", region="forearm",
              levels=(0.0, 2.0, 4.0, 6.0, 8.0), direction=1, script=_swing),
    )
}  # fmt: skip
"""C3 is a verdict and no measure; its gates have sweeps of their own in the report."""


def sweep(subject: Subject, probe: Probe) -> list[Recording]:
    """One scripted contact per level, each from the same settled state, as the scorer would get it."""
    recordings = []
    for level in probe.levels:
        simulation = subject.hovering(probe.region)
        recordings.append(recording_of(simulation, probe.region, probe.script(simulation, probe.region, level)))
    return recordings


def judge(probe: Probe, recordings: Sequence[Recording], metric: Metric) -> CheckResult:
    """Every level must have a score, and every step to the next level must change it the right way."""
    scores = [metric.compute(find_contact(recording)) for recording in recordings]
    values = np.array([np.nan if score is None else score for score in scores], np.float64)
    steps = probe.direction * np.diff(values)
    return CheckResult(
        check=probe.metric, title=f"{metric.title}: {probe.title}",
        measures=(
            *(Measure(name=f"{probe.level} {level:g}", value=float(value), unit=metric.unit)
              for level, value in zip(probe.levels, values, strict=True)),
            Measure(name="levels with a score", value=float(np.isfinite(values).sum()),
                    limit=float(len(probe.levels)), side="at least"),
            Measure(name=f"steps in which the score {'rises' if probe.direction > 0 else 'falls'}",
                    value=float((steps > 0).sum()), limit=float(len(steps)), side="at least"),
        ),
        curves={"scores": np.stack([np.array(probe.levels), values])},
    )  # fmt: skip


def run(subject: Subject, probe: Probe) -> CheckResult:
    return judge(probe, sweep(subject, probe), METRICS[probe.metric])


def draw(results: Sequence[CheckResult], figure: Figure) -> None:
    """One panel a probe."""
    figure.set_size_inches(2.0 * len(results), 2.2)
    for axes, result in zip(np.atleast_1d(figure.subplots(1, len(results))), results, strict=True):
        probe = PROBES[result.check]
        level, score = result.curves["scores"]
        axes.plot(level, score, "o-", ms=4, color="C0" if result.passed else "C1")
        unit = {"1": "", "rad": " [rad]", "N": " [N]"}.get(METRICS[result.check].unit, "")
        axes.set(xlabel=probe.level, ylabel=f"{result.check}{unit}", title=probe.title)
        if not result.passed:
            axes.text(0.5, 0.5, "not monotone", transform=axes.transAxes, ha="center", color="C1")
        low, high = axes.get_ylim()
        if low > 0:
            axes.set_ylim(0, high)
