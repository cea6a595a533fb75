"""Check 4: the arm gives way to a push as a passive arm does, comes to rest when released, and stops at its end
stops."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.subject import Subject, refuse_warnings
from carecontact.sim.simulation import Simulation

TITLE = "Passive response of the arm"
PUSHES_N, QUICK_PUSHES_N = (10.0, -10.0, 20.0, -20.0), (10.0, 20.0)
PUSH_S, RISE_S, RELEASE_S = 1.5, 0.4, 3.0
FOLD_N, FOLD_LIMIT_DEG = 10.0, 30.0
"""Push up to which a relaxed wrist may bend by no more than it extends in most tasks of a day (Palmer et al. 1985, J
Hand Surg 10A:39, as quoted by others)."""
RAMP_N_S, BREAKAWAY_M = 10.0, 0.002
LOCK_KGM2 = 1e5
"""Inertia that is added to each joint to lock it, so that 20 N turn it by less than 0.1 mrad. With a damper of 1e6 N m
s/rad instead, the whole person crept, by 1 mm on man-adult-heavy."""
REST_M_S = 0.010
STOP_TORQUE_NM = {"upper_arm": 8.0, "forearm_flexion": 5.0, "forearm_supination": 2.5, "hand": 2.0}
"""Torque that exceeds the passive joint's resistance anywhere in its range. It grows over STOP_RISE_S, like the pull of
a hand."""
QUICK_STOPS = ("forearm_flexion", "upper_arm_rotation")
STOP_RISE_S, STOP_S, OVERSHOOT_LIMIT_DEG, REACHED_DEG = 1.5, 2.0, 5.0, -2.0
ROOT_HOLD_NMS, MOVES_MM = 1e6, 20.0


def run(subject: Subject, *, quick: bool) -> CheckResult:
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    for newton in QUICK_PUSHES_N if quick else PUSHES_N:
        time, moved, speed, fold = pushed_and_released(subject.at_rest("forearm"), newton)
        released, name = time > PUSH_S, f"{newton:+.0f} N"
        late = np.flatnonzero(released & (speed > REST_M_S))
        rest = float(time[late[-1]] - PUSH_S) if len(late) else 0.0
        bend = FOLD_LIMIT_DEG if abs(newton) <= FOLD_N else None
        measures += [
            measured(f"{name}: wrist moves", 1000 * moved[~released].max(), "mm", at_least=MOVES_MM),
            measured(f"{name}: time until it is at rest again", rest, "s", at_most=RELEASE_S - 0.5),
            measured(f"{name}: wrist bends", fold[~released].max(), "deg", at_most=bend),
        ]
        curves[f"push/{name}"] = np.stack([time, 1000 * moved])
    locked, most = subject.at_rest("forearm"), max(QUICK_PUSHES_N)
    lock_arm(locked)
    time, moved, *_ = pushed_and_released(locked, most, release_s=0.0)
    name = f"{most:+.0f} N on a locked arm: wrist moves"
    measures.append(measured(name, 1000 * moved.max(), "mm", at_most=2.0))
    curves["push/locked"] = np.stack([time, 1000 * moved])
    force, moved = ramp(subject.at_rest("forearm"))
    breakaway = np.append(force[moved > BREAKAWAY_M], np.nan)[0]
    measures.append(measured("breakaway: push at which the wrist has moved 2 mm", breakaway, "N"))
    curves["ramp"] = np.stack([force, 1000 * moved])
    for hinge in subject.scene("forearm").hinges:
        side, _, rest = hinge.name.partition("_")
        if side != "right" or (quick and rest not in QUICK_STOPS):
            continue
        joint = rest.replace("_", " ")
        torque = next(value for part, value in STOP_TORQUE_NM.items() if rest.startswith(part))
        for sign in (1.0,) if quick else (1.0, -1.0):
            time, past = into_end_stop(subject.at_rest("forearm"), hinge.name, sign * torque)
            name = f"{joint} {sign * torque:+.1f} N m: past its end stop"
            measures.append(measured(f"{name}, most", past.max(), "deg", at_most=OVERSHOOT_LIMIT_DEG))
            measures.append(measured(f"{name}, at last", past[-1], "deg", at_least=REACHED_DEG))
            curves[f"stop/{joint} {'+' if sign > 0 else '-'}"] = np.stack([time, past])
    return CheckResult(check="passive-response", title=TITLE, measures=tuple(measures), curves=curves)


def push_periods(simulation: Simulation, duration_s: float, newton_at: npt.ArrayLike) -> Iterator[float]:
    """Apply a horizontal force across the forearm at its middle; yield the force [N] after every target period.

    ``newton_at``: one force [N] for each period, or one for all.
    """
    data, period = simulation.data, simulation.protocol.physics.target_period_s
    steps = round(period / simulation.model.opt.timestep)
    forearm = simulation.model.body("human_right_forearm").id
    side = np.cross([0.0, 0.0, 1.0], data.site("region_forearm").xmat.reshape(3, 3)[:, 0])
    side[2] = 0.0
    side /= np.linalg.norm(side)
    for newton in np.broadcast_to(np.asarray(newton_at, np.float64), round(duration_s / period)):
        force = newton * side
        data.xfrc_applied[forearm, :3] = force
        data.xfrc_applied[forearm, 3:] = np.cross(data.site("region_forearm").xpos - data.xipos[forearm], force)
        simulation.advance(steps)
        refuse_warnings(simulation, "while the arm was pushed")
        yield float(newton)


def pushed_and_released(
    simulation: Simulation, newton: float, *, release_s: float = RELEASE_S
) -> tuple[Array, Array, Array, Array]:
    """Push and release the arm; return time [s], horizontal displacement of the wrist [m], the person's speed [m/s] and
    the larger of the angles [deg] by which flexion and deviation of the wrist have changed, each (n,)."""
    wrist = simulation.model.body("human_right_hand").id
    hinges = [int(simulation.model.joint(f"human_right_hand_{way}").qposadr[0]) for way in ("flexion", "deviation")]
    before, straight = simulation.data.xpos[wrist].copy(), simulation.data.qpos[hinges]
    rows = []
    period = simulation.protocol.physics.target_period_s
    rise = np.minimum(1.0, np.arange(round(PUSH_S / period)) * period / RISE_S) * newton
    for duration, force in ((PUSH_S, rise), (release_s, 0.0)):
        for _ in push_periods(simulation, duration, force):
            moved = np.linalg.norm((simulation.data.xpos[wrist] - before)[:2])
            fold = np.degrees(np.abs(simulation.data.qpos[hinges] - straight).max())
            rows.append((simulation.time_s, moved, simulation.human_speed(), fold))
    time, moved, speed, fold = np.array(rows).T
    return time, moved, speed, fold


def lock_arm(simulation: Simulation) -> None:
    """Lock every joint of the right arm where it is, at rest."""
    for name in simulation.joint_names:
        if name.startswith("right_"):
            simulation.model.dof_armature[simulation.model.joint(f"human_{name}").dofadr[0]] = LOCK_KGM2


def ramp(simulation: Simulation) -> tuple[Array, Array]:
    """Push with a slowly growing force; return the force [N] and the displacement of the wrist [m], each (n,)."""
    wrist = simulation.model.body("human_right_hand").id
    before = simulation.data.xpos[wrist].copy()
    period = simulation.protocol.physics.target_period_s
    forces = np.arange(round(PUSH_S / period)) * period * RAMP_N_S
    rows = [
        (force, np.linalg.norm((simulation.data.xpos[wrist] - before)[:2]))
        for force in push_periods(simulation, PUSH_S, forces)
    ]
    return tuple(np.array(rows).T)


def into_end_stop(simulation: Simulation, joint: str, torque_nm: float) -> tuple[Array, Array]:
    """Turn one joint with a growing torque, without weight, bed or trunk motion, so that only the joint can stop it.

    Returns time (n,) [s] and the angle past the joint's range (n,) [deg], negative inside.
    """
    model, data = simulation.model, simulation.data
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    model.dof_damping[model.body("human_pelvis").dofadr[0] :][:6] = ROOT_HOLD_NMS
    hinge = next(h for h in simulation.scene.hinges if h.name == joint)
    low, high = np.radians(hinge.range_deg)
    address, dof = (int(a[0]) for a in (model.joint(f"human_{joint}").qposadr, model.joint(f"human_{joint}").dofadr))
    rows, steps = [], 5
    for count in range(round(STOP_S / model.opt.timestep / steps)):
        data.qfrc_applied[dof] = torque_nm * min(1.0, count * steps * model.opt.timestep / STOP_RISE_S)
        mujoco.mj_step(model, data, steps)
        angle = data.qpos[address]
        rows.append((data.time, np.degrees(angle - high if torque_nm > 0 else low - angle)))
    refuse_warnings(simulation, f"while {joint} was turned into its end stop")
    time, past = np.array(rows).T
    return time - time[0], past


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(8.4, 2.6)
    left, middle, right = figure.subplots(1, 3)
    pushes, stops = ({k.removeprefix(kind): v for k, v in result.curves.items() if k.startswith(kind)}
                     for kind in ("push/", "stop/"))  # fmt: skip
    for name, (time, moved) in pushes.items():
        locked = name == "locked"
        style = {"ls": "--", "color": "0.4", "label": "arm locked"} if locked else {"label": name}
        left.plot(time, moved, **style)
    left.axvspan(0, PUSH_S, color="0.94", zorder=0)
    left.axhline(MOVES_MM, color="0.4", lw=0.8, ls=":")
    left.set(xlabel="time [s]", ylabel="wrist moved [mm]", title="pushed (grey) and let go")
    left.set_ylim(-20, 1.45 * left.get_ylim()[1])
    left.legend(ncols=2, loc="upper right", handlelength=1.2)
    middle.plot(*result.curves["ramp"])
    middle.axhline(1000 * BREAKAWAY_M, color="0.4", lw=0.8, ls=":")
    middle.set(xlabel="push [N]", ylabel="wrist moved [mm]", title="slow push: breakaway", yscale="log")
    middle.set_ylim(0.1, None)
    joints = list(dict.fromkeys(name.rpartition(" ")[0] for name in stops))
    for name, (time, past) in stops.items():
        joint, _, sign = name.rpartition(" ")
        style, label = ("-", joint) if sign == "+" else ("--", None)
        right.plot(time, past, style, lw=0.9, color=f"C{joints.index(joint)}", label=label)
    right.axhline(0.0, color="0.4", lw=0.8)
    right.axhline(OVERSHOOT_LIMIT_DEG, color="0.4", lw=0.8, ls=":")
    right.set(xlabel="time [s]", ylabel="angle past the end stop [deg]", ylim=(-40, 12), title="into the end stops")
    right.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), title="solid +, dashed -", fontsize="small")
