"""Check 8: random targets that reach deep under the skin do not break the simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carecontact.sim.simulation import Simulation
from carecontact.validation.moves import DOWN, in_base, surface_point
from carecontact.validation.result import CheckResult, Measure
from carecontact.validation.subject import COMFORT_ARM_DEG, Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Stability under random actions"
TRIALS, QUICK_TRIALS = 1000, 20
TRIAL_S, NEW_TARGET_S = 0.8, 0.2
BELOW_SKIN_M, ABOVE_SKIN_M, SIDE_M = 0.040, 0.020, 0.060
PRESSED_N = 1.0
SEED = 8


def run(subject: Subject, *, quick: bool) -> CheckResult:
    count = QUICK_TRIALS if quick else TRIALS
    regions = subject.regions(quick=quick)
    peaks: list[float] = []
    broken = 0
    for number, region in enumerate(regions):
        simulation = subject.hovering(region)
        start = simulation.integration_state()
        rng = np.random.default_rng([SEED, number])
        for _ in range(number, count, len(regions)):
            simulation.restore(start, comfort_arm_deg=COMFORT_ARM_DEG)
            peak, whole = random_trial(simulation, region, rng)
            peaks.append(peak)
            broken += not whole
    pressed = float(np.mean(np.array(peaks) > PRESSED_N))
    return CheckResult(
        check="stability", title=TITLE, curves={"peaks": np.array(peaks)},
        measures=(
            Measure(name="random-action trials", value=float(len(peaks))),
            Measure(name="trials with a solver warning or a number that is not finite", value=float(broken), limit=0.0),
            Measure(name=f"share that pressed harder than {PRESSED_N:.0f} N", value=100 * pressed, unit="%", limit=50.0,
                    side="at least"),
            Measure(name="largest contact force", value=float(np.nanmax(peaks)), unit="N"),
        ),
    )  # fmt: skip


def random_trial(simulation: Simulation, region: str, rng: np.random.Generator) -> tuple[float, bool]:
    """Send random targets at the highest stiffness; return the largest contact force [N], and whether the simulation
    stayed valid.
    """
    impedance = simulation.protocol.impedance
    simulation.set_stiffness(impedance.translational_bounds[1], impedance.rotational_bounds[1])
    for warning in simulation.data.warning:
        warning.number = 0
    middle = surface_point(simulation, region)
    low = middle - [SIDE_M, SIDE_M, BELOW_SKIN_M]
    high = middle + [SIDE_M, SIDE_M, ABOVE_SKIN_M]
    peak = 0.0
    for _ in range(round(TRIAL_S / NEW_TARGET_S)):
        simulation.set_goal(np.r_[in_base(simulation, rng.uniform(low, high)), DOWN], 0.02)
        samples = simulation.advance(round(NEW_TARGET_S / simulation.model.opt.timestep))
        force = np.concatenate([np.linalg.norm(s.force, axis=2).max(1) for s in samples])
        data = simulation.data
        finite = all(np.isfinite(numbers).all() for numbers in (force, data.qpos, data.plugin_state))
        if simulation.solver_warnings() or not finite:
            return float("nan"), False
        peak = max(peak, float(force.max()))
    return peak, True


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(3.4, 2.6)
    axes = figure.subplots()
    peaks = result.curves["peaks"]
    axes.hist(peaks[np.isfinite(peaks)], bins=min(40, max(8, len(peaks) // 10)), color="C0")
    axes.set(xlabel="largest force of the trial [N]", ylabel="trials",
             title=f"{len(peaks)} random-action trials")  # fmt: skip
