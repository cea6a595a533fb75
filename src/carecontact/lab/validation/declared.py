"""The compiled world has the masses, joints, bone cores and skin that the tables declare. All of it is read from what
MuJoCo does with the model and not from the code that wrote the model: masses and centres from kinematics, springs and
dampers from torques, cores from rays, inertia and damper of the skin from its free motion."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.body import segment_inertias
from carecontact.human.hulls import plate_body, plates_of
from carecontact.human.shell import Shell
from carecontact.human.skeleton import body_name, cubic_nm_rad3, end_stop_nm, stop_name
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.subject import Subject
from carecontact.tissue.plugin import Readings
from carecontact.world.scene import Scene

KICK_M_S = 0.02
"""Speed of the kick; the skin moves by some 10 um, so that its spring is linear."""
KICK_STEPS, RETURN_STEPS, PARTS = 100, 100, 25
"""Physics steps while the kick dies and while the skin returns, and how many of them are in each of the two times."""
SMALLEST_M = 1e-12
"""Change in a sweep below which the solver stops, instead of the 1 um that is enough for contact."""
SWEEPS = 500
LIMIT_PERCENT = 1.0


TITLE = "Masses, joints, cores and skin as declared"
TURN_RAD, SPEED_RAD_S = 0.05, 1.0
"""Angle and speed by which each hinge is turned to read its spring and its damper, which are linear."""
PAST_RAD = 0.06
"""Angle past its range to which each hinge is turned to read its end stop."""
LONGEST_RAY_M = 0.15


def run(subject: Subject, *, quick: bool) -> CheckResult:
    scene = subject.scene("forearm")
    masses, centres = segment_masses(scene)
    springs, dampers, ranges, stops = joint_constants(scene)
    measures = [
        measured("mass of the person", masses[:, 0].sum(), "kg"),
        _off("deviation of the person's mass from the declared one", masses.sum(0, keepdims=True)),
        _off("mass of a segment, largest difference", masses),
        measured("centre of mass of a segment, largest distance", 1000 * centres.max(), "mm", at_most=1.0),
        _off("spring of a joint, largest difference", springs),
        _off("damper of a joint, largest difference", dampers),
        measured("end stop of a joint, largest difference", ranges.max(), "deg", at_most=0.1),
        _off("torque of an end stop, largest difference", stops),
    ]
    for region in subject.regions(quick=quick):
        measures += free_skin_measures(subject, region)
        depth = core_depths(subject.scene(region), region)
        met = np.isfinite(depth)
        under = f"{region}: skin with bone under it that the tool can meet"
        measures.append(measured(under, 100 * met.mean(), "%", at_least=95.0))
        if met.any():
            measures.append(measured(f"{region}: depth of that bone, median", 1000 * np.median(depth[met]), "mm"))
    curves = {"mass": masses, "spring": springs, "damper": dampers}
    return CheckResult(check="declared", title=TITLE, measures=tuple(measures), curves=curves)


def _off(name: str, rows: Array) -> Measure:
    """Measure the largest deviation. ``rows`` (n, 2): actual and declared value. A joint that is declared without a
    spring must have none."""
    scale = np.where(rows[:, 1] == 0, 1e-9, rows[:, 1])
    return measured(name, 100 * np.abs((rows[:, 0] - rows[:, 1]) / scale).max(), "%", at_most=1.0)


@dataclass(frozen=True, kw_only=True)
class FreeSkin:
    """How the skin of a region moves that is kicked and left alone: it shows the inertia, damper and spring with which
    the compiled tissue computes. In slow contact, the inertia shows nowhere.

    If all vertices move alike and nothing touches them, neighbours exert no force, and each vertex follows
    m w'' + d w' + a w = 0. The kick dies within some m / d, and what it displaced returns within some d / a.
    """

    dies_s: float
    """Time in which a kick dies, m / d."""
    returns_s: float
    """Time in which displaced skin returns, d / a."""


def free_skin_measures(subject: Subject, region: str) -> Iterator[Measure]:
    found, wanted = free_skin(subject, region), declared(subject, region)
    for name, at, of in (
        ("a kick of the skin dies (its inertia over its damper)", found.dies_s, wanted.dies_s),
        ("displaced skin returns (its damper over its spring)", found.returns_s, wanted.returns_s),
    ):
        time = f"{region}: time in which {name}, off the declared {1000 * of:.3g} ms"
        yield measured(time, 100 * abs(at / of - 1), "%", at_most=LIMIT_PERCENT)


def declared(subject: Subject, region: str) -> FreeSkin:
    law = subject.tissue(region)
    return FreeSkin(dies_s=law.areal_mass_kg_m2 / law.damping_ns_m3, returns_s=law.damping_ns_m3 / law.a_n_m3)


def free_skin(subject: Subject, region: str) -> FreeSkin:
    """Kick the skin of the settled person, whom nothing touches, and fit both times to its motion."""
    simulation = subject.at_rest(region)
    model, data, felt = simulation.model, simulation.data, simulation.tissue[region]
    model.numeric(f"{region}/options").data[1:3] = SMALLEST_M, SWEEPS
    wanted = declared(subject, region)
    # Vertices at rest stay out of the solver's window.
    felt.set_motion(data, np.array([SMALLEST_M, 0.0, 0.0]), np.array([KICK_M_S, 0.0, 0.0]))
    times = ((wanted.dies_s, KICK_STEPS), (wanted.returns_s, RETURN_STEPS))
    rows, late = [_follow(model, data, felt, time_s / PARTS, steps) for time_s, steps in times]
    damper, spring = -np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
    # The return shows the spring better, and hardly anything of the inertia.
    spring = -float(late[:, 2] @ (late[:, 0] + damper * late[:, 1]) / (late[:, 2] @ late[:, 2]))
    return FreeSkin(dies_s=float(1 / damper), returns_s=float(damper / spring))


def _follow(model: mujoco.MjModel, data: mujoco.MjData, felt: Readings, dt_s: float, steps: int) -> Array:
    """Return, at each of ``steps`` steps (steps, 3): acceleration [m/s^2], speed [m/s] and displacement [m] inward, as
    medians over the vertices."""
    model.opt.timestep = dt_s
    rows, before = [], float(np.median(felt.rate(data)[:, 0]))
    for _ in range(steps):
        mujoco.mj_step(model, data)
        rate, at = (float(np.median(of(data)[:, 0])) for of in (felt.rate, felt.displacement))
        rows.append(((rate - before) / dt_s, rate, at))
        before = rate
    return np.array(rows)


def segment_masses(scene: Scene) -> tuple[Array, Array]:
    """Return the actual and declared mass (S, 2) [kg] of every segment with its plates, and the distance (S,) [m] of
    the actual from the declared centre of mass."""
    model, body = scene.model, scene.body
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    declared = segment_inertias(body)
    masses, distances = [], []
    for segment in body.segments:
        bone, row = model.body(body_name(segment)).id, declared[segment]
        parts = [bone, *(model.body(plate_body(plate.name)).id for plate in plates_of(segment))]
        mass = model.body_mass[parts]
        here = data.xmat[bone].reshape(3, 3).T @ (mass @ data.xipos[parts] / mass.sum() - data.xpos[bone])
        masses.append([mass.sum(), row.mass_kg])
        distances.append(np.linalg.norm(here - (row.centre_m - body.joint_centre[segment])))
    return np.array(masses), np.array(distances)


def joint_constants(scene: Scene) -> tuple[Array, Array, Array, Array]:
    """Return actual and declared springs (J, 2) [N m/rad] and dampers (J, 2) [N m s/rad], the error (J,) [deg] of the
    angle at which end stops begin, and their actual and declared torques (2 J, 2) [N m] PAST_RAD beyond, for the lower
    and the upper end of each joint."""
    model = copy.copy(scene.model)
    data = mujoco.MjData(model)
    springs, dampers, ranges, stops = [], [], [], []

    def torque(dof: int, *, turn: float = 0.0, speed: float = 0.0) -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[joint.qposadr[0]] += turn
        data.qvel[dof] = speed
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return float(data.qfrc_spring[dof] + data.qfrc_damper[dof])

    for hinge in scene.hinges:
        joint = model.joint(f"human_{hinge.name}")
        dof = int(joint.dofadr[0])
        rest = torque(dof)
        springs.append([(rest - torque(dof, turn=TURN_RAD)) / TURN_RAD, hinge.stiffness_nm_rad])
        dampers.append([(rest - torque(dof, speed=SPEED_RAD_S)) / SPEED_RAD_S, hinge.damping_nms_rad])
        ends = model.tendon_lengthspring[model.tendon(stop_name(hinge.name)).id]
        ranges.append(np.abs(np.degrees(ends) - hinge.range_deg).max())
        at_rest = data.qpos[joint.qposadr[0]]
        for end, past in zip(ends, (-PAST_RAD, PAST_RAD), strict=True):
            spring = torque(dof, turn=end - at_rest)
            reaction = torque(dof, turn=end + past - at_rest) - spring + springs[-1][0] * past
            stops.append([reaction, float(end_stop_nm(np.array(past), np.array(cubic_nm_rad3(hinge.name))))])
    return np.array(springs), np.array(dampers), np.array(ranges), np.array(stops)


def core_depths(scene: Scene, region: str) -> Array:
    """Return, for every vertex inside the shell's border, the depth (n,) [m] at which a ray to the region's axis meets
    bone that the tool collides with; infinite where it meets none. Anchors would miss the thin bones of slim arms."""
    model = scene.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shell = scene.regions[region].shell
    bone = model.body(body_name(REGIONS[region].segment)).id
    to_world = data.xmat[bone].reshape(3, 3)
    origin = scene.body.joint_centre[REGIONS[region].segment]
    tool = model.geom(scene.robot.tip.geom)
    type_, affinity = int(tool.contype[0]), int(tool.conaffinity[0])
    collides = (model.geom_contype & affinity) | (model.geom_conaffinity & type_)
    named = [model.geom(g).name.startswith(f"human_core_{region}_") for g in range(model.ngeom)]
    cores = np.flatnonzero(np.array(named) & (collides != 0)).tolist()
    depths = []
    inside = ~border(shell)
    for vertex, axis_point in zip(shell.vertices[inside], shell.axis_points[inside], strict=True):
        start = data.xpos[bone] + to_world @ (vertex - origin)
        along = to_world @ (axis_point - vertex)
        along /= np.linalg.norm(along)
        hits = (mujoco.mj_rayMesh(model, data, g, start, along, None) for g in cores)
        depths.append(min((d for d in hits if 0 <= d < LONGEST_RAY_M), default=np.inf))
    return np.array(depths)


def border(shell: Shell) -> npt.NDArray[np.bool_]:
    """Return (N,) which vertices lie on an edge that belongs to one triangle only. The core ends there, so that a ray
    from such a vertex would run along its face."""
    sides = np.concatenate([np.roll(shell.triangles, k, axis=1)[:, :2] for k in range(3)])
    edges, count = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return np.isin(np.arange(len(shell.vertices)), edges[count == 1])


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(7.2, 2.6)
    axes = figure.subplots(1, 3)
    for ax, name, unit in zip(axes, ("mass", "spring", "damper"), ("kg", "N m/rad", "N m s/rad"), strict=True):
        made, declared = result.curves[name].T
        low, high = 0.7 * declared[declared > 0].min(), 1.4 * declared.max()
        ax.plot([low, high], [low, high], color="0.6", lw=0.8)
        ax.loglog(declared, made, "o", mfc="none")
        ax.set(xlabel=f"declared {name} [{unit}]", ylabel=f"compiled [{unit}]")
