"""The compiled world has the masses, joints, bone cores and skin that the tables declare.

All of it is read from what MuJoCo does with the model and not from the code that wrote the model: masses and centres
from kinematics, springs and dampers from torques, cores from rays, inertia and damper of the skin from its free motion.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.regions import REGIONS
from carecontact.validation import free_skin
from carecontact.validation.result import Array, CheckResult, Measure
from carecontact.validation.subject import Subject
from carecontact.world.human.anthropometry import segment_inertias
from carecontact.world.human.end_stops import cubic_nm_rad3, end_stop_nm, stop_name
from carecontact.world.human.plates import plate_body, plates_of
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        Measure(name="mass of the person", value=float(masses[:, 0].sum()), unit="kg"),
        _off("deviation of the person's mass from the declared one", [masses.sum(0)]),
        _off("mass of a segment, largest difference", masses),
        Measure(name="centre of mass of a segment, largest distance", value=1000 * float(centres.max()),
                unit="mm", limit=1.0),
        _off("spring of a joint, largest difference", springs),
        _off("damper of a joint, largest difference", dampers),
        Measure(name="end stop of a joint, largest difference", value=float(ranges.max()), unit="deg", limit=0.1),
        _off("torque of an end stop, largest difference", stops),
    ]  # fmt: skip
    for region in subject.regions(quick=quick):
        measures += free_skin.measures(subject, region)
        depth = core_depths(subject.scene(region), region)
        measures.append(
            Measure(name=f"{region}: skin with bone under it that the tool can meet",
                    value=100 * float(np.isfinite(depth).mean()), unit="%", limit=95.0, side="at least")
        )  # fmt: skip
        if np.isfinite(depth).any():
            middle = 1000 * float(np.median(depth[np.isfinite(depth)]))
            measures.append(Measure(name=f"{region}: depth of that bone, median", value=middle, unit="mm"))
    return CheckResult(check="declared", title=TITLE, measures=tuple(measures),
                       curves={"mass": masses, "spring": springs, "damper": dampers})  # fmt: skip


def _off(name: str, rows: Array | list[Array]) -> Measure:
    """Measure the largest deviation. ``rows`` (n, 2): actual and declared value. A joint that is declared without a
    spring must have none.
    """
    rows = np.asarray(rows)
    scale = np.where(rows[:, 1] == 0, 1e-9, rows[:, 1])
    return Measure(name=name, value=100 * float(np.abs((rows[:, 0] - rows[:, 1]) / scale).max()), unit="%", limit=1.0)


def segment_masses(scene: Scene) -> tuple[Array, Array]:
    """Return the actual and declared mass (S, 2) [kg] of every segment with its plates, and the distance (S,) [m] of
    the actual from the declared centre of mass.
    """
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
    and the upper end of each joint.
    """
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
    bone that the tool collides with; infinite where it meets none.

    The ray is not along the anchor, which misses the thin bones of slim arms.
    """
    model = scene.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shell = scene.regions[region].shell
    bone = model.body(body_name(REGIONS[region].segment)).id
    to_world = data.xmat[bone].reshape(3, 3)
    origin = scene.body.joint_centre[REGIONS[region].segment]
    tool = model.geom(scene.robot.tip.geom)
    cores = [
        g for g in range(model.ngeom)
        if model.geom(g).name.startswith(f"human_core_{region}_")
        and (model.geom_contype[g] & tool.conaffinity[0] or model.geom_conaffinity[g] & tool.contype[0])
    ]  # fmt: skip
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
    from such a vertex would run along its face.
    """
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
