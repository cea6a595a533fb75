"""Check 8: random commands that reach deep under the skin do not break the simulation, and the tool is never fast."""

from __future__ import annotations

import numpy as np

from carecontact.episode.log import STOPPED_OVER
from carecontact.interface.action_spaces import DAMPING_RATIO, MAX_FEEDFORWARD_N, MAX_FEEDFORWARD_NM
from carecontact.lab.validation.result import Array, CheckResult, Figure, measured
from carecontact.lab.validation.subject import COMFORT_ARM_DEG, DOWN, Subject, in_base, surface_point
from carecontact.protocol.sections import Impedance
from carecontact.sim.simulation import Simulation

TITLE = "Stability under random actions"
TRIALS, QUICK_TRIALS = 1000, 20
TRIAL_S, NEW_TARGET_S = 0.8, 0.2
BELOW_SKIN_M, ABOVE_SKIN_M, SIDE_M = 0.040, 0.020, 0.060
PRESSED_N = 1.0
FAST_PERCENT = 2.0
"""Largest share of trials in which the tool may be so fast that the robot stops itself (chosen): what it touches and a
torque about it can do that, and without a limit of speed nearly every trial does."""
SEED = 8


def run(subject: Subject, *, quick: bool) -> CheckResult:
    count, regions = QUICK_TRIALS if quick else TRIALS, subject.regions(quick=quick)
    trials: list[tuple[float, float, bool]] = []
    for number, region in enumerate(regions):
        simulation = subject.hovering(region)
        start = simulation.integration_state()
        rng = np.random.default_rng([SEED, number])
        for _ in range(number, count, len(regions)):
            simulation.restore(start, comfort_arm_deg=COMFORT_ARM_DEG)
            trials.append(random_trial(simulation, region, rng))
    peaks, fastest, whole = np.array(trials).T
    stop_m_s = STOPPED_OVER * subject.protocol.physics.max_tcp_speed_m_s
    pressed, fast = 100 * np.mean(peaks > PRESSED_N), 100 * np.mean(fastest > stop_m_s)
    measures = (
        measured("random-action trials", len(peaks)),
        measured("trials with a solver warning or a number that is not finite", (whole == 0).sum(), at_most=0.0),
        measured(f"share that pressed harder than {PRESSED_N:.0f} N", pressed, "%", at_least=50.0),
        measured("largest contact force", np.nanmax(peaks), "N"),
        measured(f"share of trials with a tool faster than {stop_m_s:g} m/s", fast, "%", at_most=FAST_PERCENT),
        measured("fastest tool", np.nanmax(fastest), "m/s"),
    )
    return CheckResult(check="stability", title=TITLE, curves={"peaks": peaks}, measures=measures)


def random_trial(simulation: Simulation, region: str, rng: np.random.Generator) -> tuple[float, float, bool]:
    """Send random legal commands; return the largest contact force [N], the largest speed of the tool [m/s], and
    whether the simulation stayed valid.

    Half the trials have the highest stiffness and nothing else; half draw a compliance with every target.
    """
    impedance, control = simulation.protocol.impedance, simulation.impedance
    control.feedforward = np.zeros(6)
    simulation.set_stiffness(impedance.translational_bounds[1], impedance.rotational_bounds[1])
    for warning in simulation.data.warning:
        warning.number = 0
    middle = surface_point(simulation, region)
    low = middle - [SIDE_M, SIDE_M, BELOW_SKIN_M]
    high = middle + [SIDE_M, SIDE_M, ABOVE_SKIN_M]
    peak, fastest, compliant = 0.0, 0.0, rng.random() < 0.5
    for _ in range(round(TRIAL_S / NEW_TARGET_S)):
        if compliant:
            stiffness, ratio, control.feedforward = random_compliance(impedance, rng)
            control.set_gains(np.array(stiffness), ratio)
        simulation.set_goal(np.r_[in_base(simulation, rng.uniform(low, high)), DOWN], 0.02)
        samples = simulation.advance(round(NEW_TARGET_S / simulation.model.opt.timestep))
        force = np.concatenate([np.linalg.norm(s.force, axis=2).max(1) for s in samples])
        data = simulation.data
        finite = all(np.isfinite(numbers).all() for numbers in (force, data.qpos, data.plugin_state))
        if simulation.solver_warnings() or not finite:
            return float("nan"), float("nan"), False
        peak = max(peak, float(force.max()))
        fastest = max(fastest, *(float(s.tcp_speed.max()) for s in samples))
    return peak, fastest, True


def random_compliance(impedance: Impedance, rng: np.random.Generator) -> tuple[tuple[float, ...], float, Array]:
    """Return a legal stiffness of the six axes, damping ratio and feedforward (6,): half of the numbers at a bound, and
    a third of the axes that have a feedforward without a spring."""

    def number(low: float, high: float) -> float:
        return float(rng.choice([low, high]) if rng.random() < 0.5 else rng.uniform(low, high))

    bounds = [impedance.translational_bounds] * 3 + [impedance.rotational_bounds] * 3
    most = [MAX_FEEDFORWARD_N] * 3 + [MAX_FEEDFORWARD_NM] * 3
    wrench = np.array([number(-m, m) * (rng.random() < 0.5) for m in most])
    stiffness = tuple(
        0.0 if w and rng.random() < 1 / 3 else number(*pair) for w, pair in zip(wrench, bounds, strict=True)
    )
    return stiffness, number(*DAMPING_RATIO), wrench


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(3.4, 2.6)
    axes = figure.subplots()
    peaks = result.curves["peaks"]
    axes.hist(peaks[np.isfinite(peaks)], bins=min(40, max(8, len(peaks) // 10)), color="C0")
    title = f"{len(peaks)} random-action trials"
    axes.set(xlabel="largest force of the trial [N]", ylabel="trials", title=title)
