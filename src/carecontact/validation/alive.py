"""Checks a person who breathes and moves the arm: what cameras see of a breath, the force that a tool measures
meanwhile, how far the arm moves, and whether a second run is the same.

The check gives the protocol's person a breath and a movement of the arm of known sizes, whatever the protocol states.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.contract.protocol import Alive, Breathing, Repositioning
from carecontact.kernel.life import JOINTS, Doings, Life, Move, breath
from carecontact.regions import REGIONS
from carecontact.sim.simulation import Samples, Simulation
from carecontact.validation import breath_seen
from carecontact.validation.breath_seen import REGION
from carecontact.validation.moves import move_to, surface_point
from carecontact.validation.result import Array, CheckResult, Measure
from carecontact.validation.scores import force_norm
from carecontact.validation.subject import COMFORT_ARM_DEG, Subject
from carecontact.world.human.skeleton import body_name
from carecontact.world.life import LIFT_RAD

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "A person who moves by itself"
BREATHS_HZ, BREATH_HZ, IN_SHARE, BREATH_M = (0.2, 0.33), 0.33, 0.455, (0.015, 0.005)
"""Rates [1/s], part of a breath that is breathing in, and size [m] of a breath: the slowest, fastest and largest breath
of the shipped protocols' levels, of which an ordinary part is breathing in. The second rate is that of the short form,
of the movements of the arm and of the repeated runs."""
BREATHES = Doings(breath_hz=BREATH_HZ, inspiration_share=IN_SHARE, breath_m=BREATH_M)
FORCE_LIMIT_PERCENT, WAY_LIMIT_MM = 10.0, 8.0
DEEP_M = 0.006
"""Depth of the fixed tool below the skin at the end of breathing out."""
HEIGHTS, QUICK_HEIGHTS = 7, 3
"""Number of heights at which a breath is held, at equal distances from breathed out to breathed in; the second number
is that of the short form."""
STILL_S = 0.6
FROZEN = 1e6
"""Armature of the robot's joints that keeps the robot in its place [kg m^2]."""
WAY_M, MOVE_S, ONSET_S, LET_GO_S = 0.06, 1.0, 1.5, 1.0
"""The movement of the arm: how far the wrist moves, how long that takes, when it begins, and for how long the check
goes on after its end."""
TENSES_S, ASIDE_RAD = 0.1, 0.1
"""How long before a movement its muscles tense, and the angle by which an external torque has turned the shoulder until
then."""
GUIDE_NM_RAD, GUIDE_NMS_RAD = 100.0, 10.0
"""Stiffness and damping of that torque."""
CUT_S, GO_ON_S = 2.0, 1.0
"""When a run is interrupted, in the middle of a breath and of a movement, and for how long it then goes on."""


def run(subject: Subject, *, quick: bool) -> CheckResult:
    living = alive(subject)
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    for hz in (BREATH_HZ,) if quick else BREATHS_HZ:
        doings = replace(BREATHES, breath_hz=hz)
        measures += breath_seen.measures(living, doings)
        time, felt, expected = fixed_tool(living, doings, heights=QUICK_HEIGHTS if quick else HEIGHTS)
        swing, wanted = np.ptp(felt), np.ptp(expected)
        # Held breaths are reached by breathing in.
        off, inward = 100 * abs(felt - expected) / wanted, time <= IN_SHARE / hz
        name = f"fixed tool, {hz:g} Hz"
        measures += [
            Measure(name=f"{name}: largest deviation of the force from that of held breaths, of its swing", unit="%",
                    value=float(off[inward].max()), limit=FORCE_LIMIT_PERCENT),
            Measure(name=f"{name}: the same while breathing out, where friction has turned round", unit="%",
                    value=float(off[~inward].max())),
            Measure(name=f"{name}: deviation of the swing of the force from that of held breaths", unit="%",
                    value=float(100 * abs(swing / wanted - 1)), limit=FORCE_LIMIT_PERCENT),
            Measure(name=f"{name}: swing of the force", value=float(swing), unit="N", limit=0.5, side="at least"),
        ]  # fmt: skip
        curves[f"{hz:g} Hz"] = np.stack([time, felt, expected])
    measures += [*arm(living), *again(living)]
    return CheckResult(check="alive", title=TITLE, measures=tuple(measures), curves=curves)


def alive(subject: Subject) -> Subject:
    """Return the same person, who can breathe and move the arm."""
    asked = Alive(breathing=Breathing(), repositioning=Repositioning())
    return subject.variant(person=subject.protocol.person.model_copy(update={"alive": asked}))


def fixed_tool(living: Subject, doings: Doings, *, heights: int) -> tuple[Array, Array, Array]:
    """Measure the force on a tool that stays in its place through one breath.

    Args:
        doings: the breath.
        heights: number of heights at which a breath is held for comparison.

    Returns three arrays (n,): time [s], force [N], and the force that held breaths give at the same height [N].
    """
    simulation = _pressed(living)
    begin = simulation.integration_state()
    held = []
    for height in np.linspace(0.0, 1.0, heights):
        simulation.restore(begin, comfort_arm_deg=COMFORT_ARM_DEG)
        _hold(simulation, doings, float(height))
        held.append(_force(simulation.advance(round(STILL_S / simulation.model.opt.timestep)))[-1])
    simulation.restore(begin, comfort_arm_deg=COMFORT_ARM_DEG)
    Life(simulation.model).wake(simulation.data, doings)
    steps = round(1 / doings.breath_hz / simulation.model.opt.timestep)
    force = _force(simulation.advance(steps))
    time = (1 + np.arange(steps)) * simulation.model.opt.timestep
    height = [breath(doings, t)[0] for t in time]
    return time, force, np.interp(height, np.linspace(0.0, 1.0, heights), held)


def _pressed(living: Subject) -> Simulation:
    """Return the person at the end of breathing out, with a tool in the skin that stays in its place."""
    simulation = living.hovering(REGION)
    move_to(simulation, surface_point(simulation, REGION) - [0.0, 0.0, DEEP_M], seconds=STILL_S)
    move_to(simulation, surface_point(simulation, REGION) - [0.0, 0.0, DEEP_M], seconds=STILL_S)
    for joint in simulation.robot.joints:
        dof = int(simulation.model.joint(joint).dofadr[0])
        simulation.model.dof_armature[dof] = FROZEN
        simulation.data.qvel[dof] = 0.0
    return simulation


def _hold(simulation: Simulation, doings: Doings, height: float) -> None:
    """Let the person breathe in to a height, from 0 (breathed out) to 1 (breathed in), and hold the breath there."""
    share = float(np.arccos(1 - 2 * height)) / np.pi
    life = Life(simulation.model)
    life.wake(simulation.data, doings)
    simulation.advance(round(share * IN_SHARE / doings.breath_hz / simulation.model.opt.timestep))
    life.wake(simulation.data, Doings(inspiration_share=IN_SHARE, phase=share * IN_SHARE, breath_m=BREATH_M))


def _force(samples: list[Samples]) -> Array:
    return force_norm(samples, REGIONS[REGION].segment)


def arm(living: Subject) -> list[Measure]:
    """Return how much the distance that the wrist moves differs from the wanted one, both for the arm as it was laid
    down and after something pushed it aside."""
    found: list[Measure] = []
    for name, aside_rad in (("as it was laid", 0.0), ("after a push", ASIDE_RAD)):
        simulation = living.at_rest(REGION)
        turned = simulation.data.joint(f"human_{JOINTS[0]}")
        wrist, asked = simulation.data.body(body_name("right_hand")), _moves(simulation)
        Life(simulation.model).wake(simulation.data, asked)
        dt, goal = simulation.model.opt.timestep, float(turned.qpos[0]) + aside_rad
        for _ in range(round((ONSET_S - TENSES_S) / dt) if aside_rad else 0):
            turned.qfrc_applied[:] = GUIDE_NM_RAD * (goal - turned.qpos) - GUIDE_NMS_RAD * turned.qvel
            simulation.advance(1)
        turned.qfrc_applied[:] = 0.0
        before = wrist.xpos.copy()
        simulation.advance(round((ONSET_S + MOVE_S + LET_GO_S - simulation.time_s) / dt))
        moved = float(np.hypot(*(wrist.xpos - before)[:2]))
        found.append(
            Measure(name=f"arm, {name}: way of the wrist against the wanted one", unit="mm",
                    value=float(1000 * abs(moved - WAY_M)), limit=WAY_LIMIT_MM)
        )  # fmt: skip
    return found


def _moves(simulation: Simulation) -> Doings:
    shift = np.zeros(len(JOINTS))
    shift[0] = WAY_M / simulation.wrist_radius_m()
    move = Move(time_s=ONSET_S, duration_s=MOVE_S, lift_rad=LIFT_RAD, shift_rad=shift)
    return replace(BREATHES, moves=(move,))


def again(living: Subject) -> list[Measure]:
    """Return how many numbers of the final state differ in any bit in a second run, and in a run that continues from a
    state in its middle."""
    runs = [living.at_rest(REGION) for _ in range(3)]
    steps = [round(seconds / runs[0].model.opt.timestep) for seconds in (CUT_S, GO_ON_S)]
    for simulation in runs:
        Life(simulation.model).wake(simulation.data, _moves(simulation))
    first, second, third = runs
    mujoco.mj_step(first.model, first.data, nstep=steps[0])
    middle = first.integration_state()
    mujoco.mj_step(first.model, first.data, nstep=steps[1])
    mujoco.mj_step(second.model, second.data, nstep=sum(steps))
    mujoco.mj_setState(third.model, third.data, middle, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_step(third.model, third.data, nstep=steps[1])
    wanted = first.integration_state()
    return [
        Measure(name=f"numbers of the state that differ in {name}", limit=0.0,
                value=float((other.integration_state() != wanted).sum()))
        for name, other in (("a second run", second), ("a run that was restored in its middle", third))
    ]  # fmt: skip


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(4.0, 2.4)
    axes = figure.subplots()
    for number, (name, (time, felt, expected)) in enumerate(result.curves.items()):
        axes.plot(time, felt, color=f"C{number}", label=f"breathing, {name}")
        axes.plot(time, expected, ":", color=f"C{number}", label="held breaths")
    axes.set(xlabel="time [s]", ylabel="force [N]", title="a fixed tool on the abdomen through a breath")
    axes.legend()
