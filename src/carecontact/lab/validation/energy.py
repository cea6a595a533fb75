"""Check 2: neither a dropped limb nor a tool that touches the skin ever gains energy, and a loading loop absorbs as
much work as the damping law gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from carecontact.human.skeleton import cubic_nm_rad3, past_range, stop_name
from carecontact.interface.robot import EMBODIMENTS
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.rig import (
    CAP,
    FLANK,
    PAD,
    Rig,
    Tool,
    declared_bench,
    of_tip,
    person_bench,
    robot_tool,
    tool,
)
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.overrides import FAST_DT_S
from carecontact.sim.bench import Press
from carecontact.sim.simulation import Simulation

SPEED_M_S, SIDEWAYS_M_S, GAP_M, BOUNCE_S = 0.2, 0.1, 0.003, 0.4
PRESS_N, DRAG_M_S, DRAG_WAY_M, DRAG_FROM_M = 3.0, 0.1, 0.1, -0.04
REST_S, RISE_S, HOLD_S = 0.3, 0.05, 0.6
"""Time before a drag begins, time in which it comes to its speed, and time of a press without a drag."""
DRAG_NS_M = 100.0
"""Damper that keeps a dragged tool at its speed."""
GLIDE_N_M = 2000.0
"""Spring that pulls a slow tool besides: at 10 mm/s the damper alone pulls with at most 1 N, and the tool stands."""
UNEXPLAINED_PERCENT, GAIN_PERCENT = 2.0, 1.0
TITLE = "Passive drop and loading loops"
LIFTS_DEG = {
    "forearm": {"right_forearm_flexion": 40.0},
    "whole arm": {"right_upper_arm_flexion": 25.0, "right_forearm_flexion": 20.0},
}
"""Lift [deg] that is added to the settled angles, so that the limb falls freely before it meets the board."""
DROP_S = 1.5
GAIN_LIMIT_PERCENT = 1.0
LOOP_DEPTH_M, LOOP_SPEEDS_M_S, QUICK_SPEEDS_M_S = 0.004, (0.005, 0.020, 0.080), (0.020,)
LOOP_SHARE_PERCENT, LOOP_EXCESS_PERCENT = 80.0, 125.0
"""Bounds of the absorbed work, relative to what the declared damping absorbs in the same loop; springs without dampers
absorb less than a fifth of it."""
PEAK_LIMIT_PERCENT = 3.0
"""Limit, chosen by us, of the difference between the loop's peak under the person's compiled law and under the declared
law on the same shell. For a region without a reference of its own, it is the only check of the stiffness."""
LOST_SPEED_M_S, LOST_LIMIT_PERCENT, RETURNED_LIMIT_PERCENT = 0.020, 5.0, 20.0
"""Speed and limits, chosen by us, that detect a set with almost no damping or with the behaviour of putty, whatever it
declares: living tissue returns less energy than it receives, and springs back."""


def run(subject: Subject, *, quick: bool) -> CheckResult:
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    for name in ("whole arm",) if quick else LIFTS_DEG:
        simulation = subject.at_rest("forearm")
        settled = Energy(simulation)()
        time, energy, given = drop(simulation, LIFTS_DEG[name])
        lifted, own = energy[0] - settled, energy - given
        gain, work = ((100 * of).max() / lifted for of in (own - np.minimum.accumulate(own), given))
        lost = 100 * (energy[0] - energy[-1]) / lifted
        name = f"{name} dropped"
        measures += [
            measured(f"{name}: energy lifted", lifted, "J"),
            measured(
                f"{name}: gain without work from bed, of the energy lifted", gain, "%", at_most=GAIN_LIMIT_PERCENT
            ),
            measured(f"{name}: net work given by bed, of the energy lifted", work, "%", at_most=GAIN_LIMIT_PERCENT),
            measured(f"{name}: share of the energy lost in the end", lost, "%", at_least=80.0),
        ]
        curves[f"drop/{name.removesuffix(' dropped')}"] = np.stack([time, energy - settled, own - settled])
    for region in subject.regions(quick=quick):
        measures += ledger_measures(subject, region, quick=quick)
        if not quick:
            measures += made_energy_measures(subject, region)
        benches = [make(subject, region, tool(subject)) for make in (person_bench, declared_bench)]
        for speed in QUICK_SPEEDS_M_S if quick else LOOP_SPEEDS_M_S:
            loop, declared = (
                bench.press(depth_m=LOOP_DEPTH_M, speed_m_s=speed, unload=True, sample_s=bench.model.opt.timestep)
                for bench in benches
            )
            measures += _loop_measures(f"{region} loop at {1000 * speed:.0f} mm/s", speed, loop, declared)
            curves[f"loop/{region}/{1000 * speed:.0f}"] = np.stack([loop.indentation_m, loop.force_n])
    return CheckResult(check="energy", title=TITLE, measures=tuple(measures), curves=curves)


def _loop_measures(name: str, speed_m_s: float, loop: Press, declared: Press) -> Iterator[Measure]:
    decides, share = speed_m_s <= QUICK_SPEEDS_M_S[0], 100 * _work(loop) / _work(declared)
    peak = 100 * abs(loop.force_n.max() / declared.force_n.max() - 1)
    of_law, off = "share of the work of the declared law", "deviation of the peak force from the declared law"
    against = "work against that of the declared law"
    yield measured(f"{name}: work", 1000 * _work(loop), "mJ", at_least=0.0)
    yield measured(f"{name}: {of_law}", share, "%", at_least=LOOP_SHARE_PERCENT, decides=decides)
    yield measured(f"{name}: {against}", share, "%", at_most=LOOP_EXCESS_PERCENT, decides=decides)
    yield measured(f"{name}: {off}", peak, "%", at_most=PEAK_LIMIT_PERCENT, decides=decides)
    if speed_m_s == LOST_SPEED_M_S:
        put_in = np.trapezoid(loop.force_n[loop.loading], loop.indentation_m[loop.loading])
        lost = float(100 * _work(loop) / put_in)
        back = f"{name}: work that comes back, of the work put in"
        yield measured(f"{name}: work that is lost, of the work put in", lost, "%", at_least=LOST_LIMIT_PERCENT)
        yield measured(back, 100 - lost, "%", at_least=RETURNED_LIMIT_PERCENT)


def _work(loop: Press) -> float:
    """Return the work [J] that the indenter does on the tissue over the whole loop."""
    return float(np.trapezoid(loop.force_n, loop.indentation_m))


def drop(simulation: Simulation, lift_deg: dict[str, float]) -> tuple[Array, Array, Array]:
    """Lift joints by angles and let go.

    Returns at every step time (n,) [s], the person's mechanical energy (n,) [J] and the work (n,) [J] that bed contacts
    have done on the person so far. What the padded bed stores and returns is no gain of energy.
    """
    model, data = simulation.model, simulation.data
    for joint, angle in lift_deg.items():
        data.qpos[model.joint(f"human_{joint}").qposadr[0]] += np.radians(angle)
    data.qvel[:] = 0.0
    energy = Energy(simulation)
    rows, given = [energy()], [0.0]
    for _ in range(round(DROP_S / model.opt.timestep)):
        before = data.qvel[energy.dof].copy()
        mujoco.mj_step(model, data)
        # An impulse changes the kinetic energy by its product with the mean of the velocities before and after.
        velocity = (before + data.qvel[energy.dof]) / 2
        given.append(given[-1] + float(data.qfrc_constraint[energy.dof] @ velocity) * model.opt.timestep)
        rows.append(energy())
    return np.arange(len(rows)) * model.opt.timestep, np.array(rows), np.array(given)


class Energy:
    """Computes the person's kinetic energy and the potential energy of weight, joint springs and end stops. Contacts,
    the robot and the tissue are left out, because nothing touches the tissue here."""

    def __init__(self, simulation: Simulation) -> None:
        self._model, self._data = simulation.model, simulation.data
        model = simulation.model
        root = model.body("human_pelvis").id
        self._bodies = np.flatnonzero(model.body_rootid == root)
        joints = np.flatnonzero(np.isin(model.jnt_bodyid, self._bodies))
        self.dof = np.isin(model.dof_bodyid, self._bodies)
        self._springs = joints[model.jnt_type[joints] != mujoco.mjtJoint.mjJNT_FREE]
        names = [hinge.name for hinge in simulation.scene.hinges]
        self._stops = np.array([model.tendon(stop_name(name)).id for name in names])
        self._cubic = np.array([cubic_nm_rad3(name) for name in names])
        self._mass_times_v = np.zeros(model.nv)

    def __call__(self) -> float:
        model, data = self._model, self._data
        # After a step, poses and mass matrix are still those of its beginning; compute those of its end.
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_tendon(model, data)
        velocity = np.where(self.dof, data.qvel, 0.0)
        mujoco.mj_mulM(model, data, self._mass_times_v, velocity)
        weight = -float(model.body_mass[self._bodies] @ data.xipos[self._bodies] @ model.opt.gravity)
        at = model.jnt_qposadr[self._springs]
        x = data.qpos[at] - model.qpos_spring[at]
        springs = float((model.jnt_stiffness[self._springs] * x**2 / 2).sum())
        past = past_range(data.ten_length[self._stops], *model.tendon_lengthspring[self._stops].T)
        stops = float((self._cubic * past**4 / 4).sum())
        return 0.5 * float(velocity @ self._mass_times_v) + weight + springs + stops


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """The energies [J] of one contact of a tool that bounces on the skin, is pressed into it or is dragged over it."""

    put_in: float
    """Kinetic energy of the tool at the start plus the work of the driving forces."""
    lost: float
    """Energy that dampers and friction absorbed, as the compiled tissue counts it."""
    balance: Array
    """(n,) energy of tool and tissue plus what was lost until then, minus what was put in until then, at the beginning
    of every step. 0: everything is accounted for; more: energy was made."""

    @property
    def unexplained(self) -> float:
        """Share of the input that is nowhere at the end; negative if there is more energy than was put in."""
        return -float(self.balance[-1]) / self.put_in

    @property
    def gain(self) -> float:
        """Largest excess of energy at any instant, as a share of the input."""
        return float(self.balance.max()) / self.put_in

    @property
    def rise(self) -> float:
        """Largest rise of ``balance`` over an earlier instant, as a share of the input: energy that was made after as
        much had vanished, too. It also has what a damper's force is late: half a step of its power."""
        return float((self.balance - np.minimum.accumulate(self.balance)).max()) / self.put_in

    def measures(self, name: str, *, decides: bool = True) -> list[Measure]:
        nowhere, made = "energy that is not accounted for, of that put in", "most energy made until any instant"
        rises, off = "largest rise of the energy between two instants", 100 * abs(self.unexplained)
        return [
            measured(f"{name}: {nowhere}", off, "%", at_most=UNEXPLAINED_PERCENT, decides=decides),
            measured(f"{name}: {made}, of that put in", 100 * self.gain, "%", at_most=GAIN_PERCENT, decides=decides),
            measured(f"{name}: {rises}, of that put in", 100 * self.rise, "%"),
        ]


@dataclass(frozen=True, kw_only=True)
class Hard:
    """One contact of a certain tool of 1 kg."""

    tool: Tool
    how: str
    contact: Callable[..., Ledger]

    def measures(
        self, subject: Subject, region: str, *, dt_s: float, place: str, decides: bool = True
    ) -> list[Measure]:
        name = f"{place}: {self.tool.name} of 1 kg {self.how} at {1000 * dt_s:g} ms"
        return self.contact(subject, region, self.tool, dt_s=dt_s).measures(name, decides=decides)


def ledger_measures(subject: Subject, region: str, *, quick: bool) -> Iterator[Measure]:
    """Yield what each tool and contact measured, at the protocol's step and at that of the fast mode."""
    tool = robot_tool(subject)
    contacts = [
        Hard(tool=one, how=how, contact=contact)
        for one in (tool, *(() if quick else (PAD, FLANK)))
        for how, contact in CASES.items()
    ]
    for dt_s in steps_s(subject, quick=quick):
        for hard in (*contacts, *(() if quick else of_the_layer(region, tool))):
            yield from hard.measures(subject, region, dt_s=dt_s, place=region)


def made_energy_measures(subject: Subject, region: str) -> Iterator[Measure]:
    """Yield what contacts beyond those that the check judges measured: harder, faster and deeper. In some of them,
    energy is made or vanishes, which is reported and decides nothing."""
    for dt_s in steps_s(subject, quick=False):
        for hard in HARD:
            yield from hard.measures(subject, region, dt_s=dt_s, place=f"{region}, beyond the claim", decides=False)


def steps_s(subject: Subject, *, quick: bool) -> list[float]:
    shipped = subject.protocol.physics.dt_s
    return [shipped] if quick else sorted({shipped, FAST_DT_S})


def bounce(
    subject: Subject, region: str, tool: Tool, *, speed_m_s: float, sideways_m_s: float = 0.0, dt_s: float
) -> Ledger:
    """Let a free tool of 1 kg fly with a speed into the skin and one along the region against its middle and back."""
    rig = Rig(subject, region, tool, joints="free", dt_s=dt_s)
    # The velocity of a free body is given in the axes of the world.
    along, _, outward = rig.data.body("tool").xmat.reshape(3, 3).T
    rig.reset(position=rig.data.qpos[:3] + GAP_M * outward, velocity=sideways_m_s * along - speed_m_s * outward)
    return _ledger(rig, np.zeros_like, BOUNCE_S)


def drag(subject: Subject, region: str, tool: Tool, *, press_n: float, speed_m_s: float, dt_s: float) -> Ledger:
    """Press a tool of 1 kg, which slides keep upright, suddenly onto the skin, and drag it by DRAG_WAY_M along the
    region.

    Args:
        press_n: force into the skin; nothing else carries the tool.
        speed_m_s: at which a stiff damper drags it; 0: it is only pressed, at the region's middle, for HOLD_S.
    """
    rig = Rig(subject, region, tool, joints="slides", dt_s=dt_s)
    begin = DRAG_FROM_M if speed_m_s else 0.0
    rig.reset(position=(begin, GAP_M + rig.clear_of_m(begin)))

    def force(velocity: Array) -> Array:
        wanted = speed_m_s * min(1.0, max(0.0, (rig.data.time - REST_S) / RISE_S))
        return np.array([DRAG_NS_M * (wanted - velocity[0]), -press_n])

    return _ledger(rig, force, REST_S + DRAG_WAY_M / speed_m_s if speed_m_s else HOLD_S)


def glide(subject: Subject, region: str, tool: Tool, *, press_n: float, speed_m_s: float, dt_s: float) -> Ledger:
    """Press a tool of 1 kg as ``drag`` does, and pull it slowly by DRAG_WAY_M along the region, through a spring."""
    rig = Rig(subject, region, tool, joints="slides", dt_s=dt_s)
    rig.reset(position=(DRAG_FROM_M, GAP_M + rig.clear_of_m(DRAG_FROM_M)))

    def force(velocity: Array) -> Array:
        gone = max(0.0, rig.data.time - REST_S)
        behind = DRAG_FROM_M + speed_m_s * gone - rig.data.qpos[0]
        return np.array([GLIDE_N_M * behind + DRAG_NS_M * ((gone > 0) * speed_m_s - velocity[0]), -press_n])

    return _ledger(rig, force, REST_S + DRAG_WAY_M / speed_m_s)


def _ledger(rig: Rig, force: Callable[[Array], Array], seconds: float) -> Ledger:
    """Simulate, and keep the ledger at the beginning of every step.

    The tissue responds to where the tool is at the beginning of a step, and the tool's velocities belong to the middles
    of the steps before and after. Half of v M v', their product, is the kinetic energy at the beginning that the scheme
    conserves with a linear spring. What the tissue loses in a step pushes the tool in the next, so that half of it is
    counted before and half after. A damper that adds energy is not counted as a negative loss.
    """
    model, data = rig.model, rig.data
    began, work, lost, rubbed = rig.kinetic_j(), 0.0, 0.0, 0.0
    momentum, pushed, balance = np.zeros(model.nv), np.zeros(model.nv), [0.0]
    for _ in range(round(seconds / model.opt.timestep)):
        before = data.qvel.copy()
        data.qfrc_applied[:] = force(before)
        # The force of a driver acts on both sides of the beginning of a step.
        work += float((pushed + data.qfrc_applied) @ before) / 2 * model.opt.timestep
        pushed = data.qfrc_applied.copy()
        mujoco.mj_step(model, data)
        mujoco.mj_mulM(model, data, momentum, data.qvel)
        row = rig.felt.last(data, 1)[0]
        rubbed = max(0.0, float(row["damped_j"])) + max(0.0, float(row["rubbed_j"]))
        lost += rubbed
        held = float(before @ momentum) / 2 + float(row["stored_j"] + row["kinetic_j"])
        balance.append(held + lost - rubbed / 2 - began - work)
    return Ledger(put_in=began + work, lost=lost, balance=np.array(balance))


CASES = {
    "bounced": partial(bounce, speed_m_s=SPEED_M_S),
    "bounced aslant": partial(bounce, speed_m_s=SPEED_M_S, sideways_m_s=SIDEWAYS_M_S),
    "dragged": partial(drag, press_n=PRESS_N, speed_m_s=DRAG_M_S),
}
"""What ``ledger_measures`` does with each tool."""


def dragged(tool: Tool, press_n: float, speed_m_s: float) -> Hard:
    how = f"pressed with {press_n:g} N and dragged at {speed_m_s:g} m/s"
    return Hard(tool=tool, how=how, contact=partial(drag, press_n=press_n, speed_m_s=speed_m_s))


def pressed(tool: Tool, press_n: float) -> Hard:
    contact = partial(drag, press_n=press_n, speed_m_s=0.0)
    return Hard(tool=tool, how=f"pressed suddenly with {press_n:g} N", contact=contact)


PILE = replace(PAD, name="pad of pile", give_m3_n=8e-7)
"""The pad, covered with a pile 1.6 times as soft as the wash mitt, so that much of the energy is in the contact
layer."""


def of_the_layer(region: str, tool: Tool) -> tuple[Hard, ...]:
    """Return the contacts on a region that judge the layer that stiffens and the skin that is let in.

    In the drags, skin comes to lie deep in the tool without having been pressed there: without the brake of the tool,
    the cap's has 20 to 30 % more energy than was put in. The pile is compressed far beyond where it is linear: with the
    energy of a linear layer, 4 % is missing.
    """
    if region == "upper_arm":
        return (pressed(PILE, 12.0),)
    if region != "abdomen":
        return ()
    how, slowly = "pressed with 12 N and pulled at 0.01 m/s", partial(glide, press_n=12.0, speed_m_s=0.01)
    return dragged(tool, 10.0, 0.3), dragged(PAD, 7.0, 0.1), Hard(tool=tool, how=how, contact=slowly)


MITT = of_tip("mitt", EMBODIMENTS["mitt"].tip)


def _nose_down(tool: Tool, degrees: float) -> Tool:
    """Return a box whose front edge, towards which it is dragged, is turned down."""
    half = np.radians(degrees) / 2
    lowest = tool.size_m[0] * np.sin(2 * half) + tool.size_m[2] * np.cos(2 * half)
    name, turned = (
        f"{tool.name} with its nose {degrees:g} degrees down",
        (float(np.cos(half)), 0.0, float(np.sin(half))),
    )
    return replace(tool, name=name, height_m=float(lowest), turned=(*turned, 0.0))


def _aslant(tool: Tool, speed_m_s: float) -> Hard:
    contact = partial(bounce, speed_m_s=speed_m_s, sideways_m_s=speed_m_s)
    return Hard(tool=tool, how=f"bounced aslant at {speed_m_s:g} m/s both ways", contact=contact)


HARD = (
    dragged(CAP, 5.0, 0.1), dragged(CAP, 5.0, 0.3), dragged(CAP, 10.0, 0.1), dragged(CAP, 10.0, 0.3),
    dragged(PAD, 5.0, 0.1), dragged(PAD, 7.0, 0.1), dragged(PAD, 10.0, 0.2),
    dragged(_nose_down(PAD, 20.0), 3.0, 0.1), dragged(MITT, 10.0, 0.1), dragged(MITT, 15.0, 0.1),
    pressed(CAP, 15.0), pressed(CAP, 20.0), _aslant(CAP, 0.5), _aslant(CAP, 0.8), _aslant(PAD, 0.8),
)  # fmt: skip


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(6.6, 2.6)
    left, right = figure.subplots(1, 2)
    for colour, name in zip(("C0", "C1"), LIFTS_DEG, strict=True):
        if f"drop/{name}" in result.curves:
            time, energy, own = result.curves[f"drop/{name}"]
            left.plot(time, energy, color=colour, label=name)
            left.plot(time, own, color=colour, ls=":", label=f"{name}, without the bed's work")
    left.set(xlabel="time after release [s]", ylabel="energy over the settled state [J]", title="passive drop")
    left.set_xlim(0, 0.6)
    left.axhline(0.0, color="0.5", lw=0.6)
    left.set_ylim(None, 1.6 * left.get_ylim()[1])
    left.legend(loc="upper right")
    speed = f"{1000 * QUICK_SPEEDS_M_S[0]:.0f}"
    for name in result.curves:
        region = name.removeprefix("loop/").removesuffix(f"/{speed}")
        if name == f"loop/{region}/{speed}":
            depth, force = result.curves[name]
            right.plot(1000 * depth, force, label=region.replace("_", " "))
    right.set(xlabel="indentation [mm]", ylabel="force [N]", title=f"loading and unloading at {speed} mm/s")
    right.legend()
