"""Four scripted sweeps in simulation: each score must follow the one property of a contact that it measures.

It is not enough that a score rises with a sweep, because in a deeper push the mean force rises with the peak. Each
score is therefore also compared with the same quantity, measured without the scorer's streams, and everything else in a
trial is the same over a sweep.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.metric import METRICS, Metric
from carecontact.validation import sweeps
from carecontact.validation.result import Array, CheckResult, Measure
from carecontact.validation.subject import Subject
from carecontact.validation.sweeps import Script, Trial

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

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
    probe.metric: probe
    for probe in (
        Probe(metric="C1@1", title="deeper push", level="commanded depth [mm]", region="forearm",
              levels=(12.0, 20.0, 28.0, 36.0, 44.0), direction=1, step=1.0,
              known="largest force in the tissue's springs", tolerance=0.2, script=sweeps.deeper_push),
        Probe(metric="C2@1", title="joint past its ends", level="torque [N m]", region="abdomen",
              levels=(-5.5, -4.5, -3.5, -2.5, -1.5, 1.5, 2.5, 3.5, 4.5, 5.5), direction=-1, step=0.001,
              known="margin computed from the poses of the bones", tolerance=0.0005, script=sweeps.joint_turned),
        Probe(metric="C4@1", title="stop and go", level="pause after each way [s]", region="forearm",
              levels=(0.4, 0.65, 0.9, 1.15, 1.4), direction=-1, step=0.04,
              known="share computed from differences of poses", tolerance=0.005, script=sweeps.stop_and_go),
        Probe(metric="C5@1", title="swinging force", level="amplitude of depth [mm]", region="forearm",
              levels=(2.0, 5.0, 8.0, 11.0, 14.0), direction=1, step=0.15,
              known="spread of force in the tissue's springs", tolerance=0.05, script=sweeps.swinging_force),
    )
}  # fmt: skip
"""Metric -> its probe. C3 has none because it is a verdict and not a measurement; reports have sweeps of its gates."""


def sweep(subject: Subject, probe: Probe) -> list[Trial]:
    """Run one scripted trial for each level, each from the same settled state, as the scorer would receive it."""
    return [probe.script(subject.hovering(probe.region), probe.region, level) for level in probe.levels]


def judge(probe: Probe, trials: Sequence[Trial], metric: Metric) -> CheckResult:
    """Judge a sweep: at every level the score must equal the known quantity, every step must change it in the right
    direction and by enough, and the quantities that the sweep keeps must stay the same.
    """
    scores = [metric.compute(find_contact(trial.recording)) for trial in trials]
    values = np.array([np.nan if score is None else score for score in scores], np.float64)
    known = np.array([trial.known for trial in trials])
    return CheckResult(
        check=probe.metric, title=f"{metric.title}: {probe.title}",
        measures=(
            *(Measure(name=f"{probe.level} {level:g}", value=float(value), unit=metric.unit)
              for level, value in zip(probe.levels, values, strict=True)),
            Measure(name="levels with a score", value=float(np.isfinite(values).sum()),
                    limit=float(len(probe.levels)), side="at least"),
            Measure(name=f"smallest step by which the score {'rises' if probe.direction > 0 else 'falls'}",
                    value=float(steps(probe, values).min()), unit=metric.unit, limit=probe.step, side="at least"),
            Measure(name=f"largest difference from the {probe.known}", value=float(np.abs(values - known).max()),
                    unit=metric.unit, limit=probe.tolerance),
            *(Measure(name=f"kept the same: {name}, range over mean", limit=HELD,
                      value=spread(np.array([trial.held[name] for trial in trials])))
              for name in trials[0].held),
        ),
        curves={"scores": np.stack([np.array(probe.levels), values]), "known": known},
    )  # fmt: skip


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
    """Draw one panel for each probe."""
    figure.set_size_inches(2.0 * len(results), 2.2)
    for axes, result in zip(np.atleast_1d(figure.subplots(1, len(results))), results, strict=True):
        probe = PROBES[result.check]
        level, score = result.curves["scores"]
        if "known" in result.curves:
            axes.plot(level, result.curves["known"], "s", ms=7, mfc="none", color="0.5", label="independent reference")
        for side in (level < 0, level >= 0):
            axes.plot(level[side], score[side], "o-", ms=4, color="C0" if result.passed else "C1",
                      label="score" if side[-1] else None)  # fmt: skip
        unit = {"1": "", "rad": " [rad]", "N": " [N]"}.get(METRICS[result.check].unit, "")
        axes.set(xlabel=probe.level, ylabel=f"{result.check}{unit}", title=probe.title)
        if not result.passed:
            axes.text(0.5, 0.5, "failed", transform=axes.transAxes, ha="center", color="C1")
        axes.margins(y=0.08)
        if np.nanmin(score) > 0:
            axes.set_ylim(0, 1.1 * float(np.nanmax(score)))
    figure.axes[0].legend(loc="best")
