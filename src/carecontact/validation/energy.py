"""Check 2: a dropped limb never gains energy, a tool that touches the skin never does, and a loading loop absorbs as
much work as the damping law says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.sim.bench import Press
from carecontact.sim.simulation import Simulation
from carecontact.validation import energy_made, ledger
from carecontact.validation.pressing import declared_bench, person_bench, tool
from carecontact.validation.result import Array, CheckResult, Measure
from carecontact.validation.subject import Subject
from carecontact.world.human.end_stops import cubic_nm_rad3, past_range, stop_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        measures += [
            Measure(name=f"{name} dropped: energy lifted", value=float(lifted), unit="J"),
            Measure(name=f"{name} dropped: gain without work from bed, of the energy lifted",
                    value=float(100 * (own - np.minimum.accumulate(own)).max() / lifted), unit="%",
                    limit=GAIN_LIMIT_PERCENT),
            Measure(name=f"{name} dropped: net work given by bed, of the energy lifted",
                    value=float(100 * given.max() / lifted), unit="%", limit=GAIN_LIMIT_PERCENT),
            Measure(name=f"{name} dropped: share of the energy lost in the end",
                    value=float(100 * (energy[0] - energy[-1]) / lifted), unit="%", limit=80.0, side="at least"),
        ]  # fmt: skip
        curves |= {f"drop/{name}": np.stack([time, energy - settled, own - settled])}
    for region in subject.regions(quick=quick):
        measures += ledger.measures(subject, region, quick=quick)
        if not quick:
            measures += energy_made.measures(subject, region)
        benches = person_bench(subject, region, tool(subject)), declared_bench(subject, region, tool(subject))
        for speed in QUICK_SPEEDS_M_S if quick else LOOP_SPEEDS_M_S:
            loop, declared = (
                bench.press(depth_m=LOOP_DEPTH_M, speed_m_s=speed, unload=True, sample_s=bench.model.opt.timestep)
                for bench in benches
            )
            name = f"{region} loop at {1000 * speed:.0f} mm/s"
            measures += [
                Measure(name=f"{name}: work", value=1000 * _work(loop), unit="mJ", limit=0.0, side="at least"),
                Measure(name=f"{name}: share of the work of the declared law", unit="%",
                        value=100 * _work(loop) / _work(declared), limit=LOOP_SHARE_PERCENT, side="at least",
                        decides=speed <= QUICK_SPEEDS_M_S[0]),
                Measure(name=f"{name}: work against that of the declared law", unit="%",
                        value=100 * _work(loop) / _work(declared), limit=LOOP_EXCESS_PERCENT,
                        decides=speed <= QUICK_SPEEDS_M_S[0]),
                Measure(name=f"{name}: deviation of the peak force from the declared law", unit="%",
                        limit=PEAK_LIMIT_PERCENT,
                        value=float(100 * abs(loop.force_n.max() / declared.force_n.max() - 1)),
                        decides=speed <= QUICK_SPEEDS_M_S[0]),
            ]  # fmt: skip
            if speed == LOST_SPEED_M_S:
                put_in = np.trapezoid(loop.force_n[loop.loading], loop.indentation_m[loop.loading])
                lost = float(100 * _work(loop) / put_in)
                measures += [
                    Measure(name=f"{name}: work that is lost, of the work put in", value=lost, unit="%",
                            limit=LOST_LIMIT_PERCENT, side="at least"),
                    Measure(name=f"{name}: work that comes back, of the work put in", value=100 - lost, unit="%",
                            limit=RETURNED_LIMIT_PERCENT, side="at least"),
                ]  # fmt: skip
            curves |= {f"loop/{region}/{1000 * speed:.0f}": np.stack([loop.indentation_m, loop.force_n])}
    return CheckResult(check="energy", title=TITLE, measures=tuple(measures), curves=curves)


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
    the robot and the tissue are left out, because nothing touches the tissue here.
    """

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
        """Return the energy [J]."""
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


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(6.6, 2.6)
    left, right = figure.subplots(1, 2)
    for colour, name in zip(("C0", "C1"), LIFTS_DEG, strict=True):
        if f"drop/{name}" in result.curves:
            time, energy, own = result.curves[f"drop/{name}"]
            left.plot(time, energy, color=colour, label=name)
            left.plot(time, own, color=colour, ls=":", label=f"{name}, without the bed's work")
    left.set(
        xlim=(0, 0.6), xlabel="time after release [s]", ylabel="energy over the settled state [J]", title="passive drop"
    )
    left.axhline(0.0, color="0.5", lw=0.6)
    left.set_ylim(None, 1.6 * left.get_ylim()[1])
    left.legend(loc="upper right")
    loops = [name for name in result.curves if name.endswith(f"/{1000 * QUICK_SPEEDS_M_S[0]:.0f}")]
    for number, name in enumerate(loops):
        depth, force = result.curves[name]
        right.plot(1000 * depth, force, color=f"C{number}", label=name.split("/")[1].replace("_", " "))
    right.set(xlabel="indentation [mm]", ylabel="force [N]",
              title=f"loading and unloading at {1000 * QUICK_SPEEDS_M_S[0]:.0f} mm/s")  # fmt: skip
    right.legend()
