"""Segments as bodies with hinges, inertias, bed proxies and the rigid surface that a robot can touch."""

from __future__ import annotations

import mujoco
import numpy as np

from carecontact.world.human.anthropometry import segment_inertias
from carecontact.world.human.body import PARENT, Array, Body
from carecontact.world.human.joints import Hinge, hinges
from carecontact.world.human.pose import FIXED_SEGMENTS, lying_pose_deg, rotation_from_bind
from carecontact.world.human.shell import belly_span

# Collision bits. The robot has contype 1; bed and arm board have conaffinity 3 and so meet both robot and proxies.
ROBOT_ONLY = {"contype": 0, "conaffinity": 1}
BED_ONLY = {"contype": 2, "conaffinity": 0}
HIDDEN_GROUP = 3

SOFT_SEGMENTS = {"forearm": "right_forearm", "upper_arm": "right_upper_arm", "abdomen": "abdomen"}


def body_name(segment: str) -> str:
    return f"human_{segment}"


def tissue_body_name(region: str) -> str:
    """A body without joints that holds a region's shell, so that one contact sensor sees the shell and nothing else."""
    return f"human_{SOFT_SEGMENTS[region]}_tissue"


def add_skeleton(
    spec: mujoco.MjSpec, body: Body, *, root_position: Array, root_quat: Array, shell_mass: dict[str, float]
) -> list[Hinge]:
    """Add every segment under a free root; returns the hinges in the order of their joints.

    ``shell_mass`` [kg] is taken off the segment that carries a shell, so that the person's mass stays the body's.
    """
    inertias = segment_inertias(body)
    rows, pose = hinges(body), lying_pose_deg(0.0)
    bodies: dict[str, mujoco.MjsBody] = {}
    for segment in body.segments:
        parent = PARENT[segment]
        at = body.joint_centre[segment]
        if parent is None:
            made = spec.worldbody.add_body(name=body_name(segment), pos=root_position, quat=root_quat)
            made.add_freejoint(name="human_root")
        else:
            made = bodies[parent].add_body(name=body_name(segment), pos=at - body.joint_centre[parent])
        bodies[segment] = made
        row = inertias[segment]
        made.explicitinertial = True
        made.mass = row.mass_kg - shell_mass.get(segment, 0.0)
        made.ipos = row.centre_m - at
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, row.axes.ravel())
        made.iquat = quat
        made.inertia = row.moments_kgm2
        if segment in FIXED_SEGMENTS:
            turn = np.zeros(4)
            mujoco.mju_mat2Quat(turn, rotation_from_bind(rows, segment, pose).ravel())
            made.quat = turn
            continue
        for hinge in rows:
            if hinge.segment == segment:
                _add_hinge(made, hinge)
    for region, segment in SOFT_SEGMENTS.items():
        bodies[segment].add_body(name=tissue_body_name(region))
    _add_bed_proxies(body, bodies)
    _add_rigid_surface(spec, body, bodies)
    return [row for row in rows if row.segment not in FIXED_SEGMENTS]


def _add_hinge(to: mujoco.MjsBody, hinge: Hinge) -> None:
    radians = np.radians
    to.add_joint(
        name=f"human_{hinge.name}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis, ref=radians(hinge.bind_deg),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE, range=radians(hinge.range_deg),
        stiffness=[hinge.stiffness_nm_rad, 0, 0], springref=radians(hinge.bind_deg),
        damping=[hinge.damping_nms_rad, 0, 0], armature=0.002,
    )  # fmt: skip


def _add_bed_proxies(body: Body, bodies: dict[str, mujoco.MjsBody]) -> None:
    """Spheres and short capsules tangent to the back of the body: they meet only the bed."""

    def sphere(segment: str, name: str, surface: Array, radius: float) -> None:
        centre = surface - np.array([0, radius, 0]) - body.joint_centre[segment]
        bodies[segment].add_geom(
            name=f"human_proxy_{name}", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre, size=[radius, 0, 0], mass=0,
            group=HIDDEN_GROUP, condim=3, **BED_ONLY,
        )  # fmt: skip

    def back_of(points: Array, near: Array, radius: float = 0.04) -> Array:
        """Rearmost surface point near a point, seen along the body's front-back axis."""
        close = points[np.hypot(points[:, 0] - near[0], points[:, 2] - near[2]) < radius]
        if len(close) == 0:
            close = points[[np.hypot(points[:, 0] - near[0], points[:, 2] - near[2]).argmin()]]
        return np.array([near[0], close[:, 1].max(), near[2]])

    j = body.joint_centre
    trunk = body.vertices_of("pelvis", "abdomen", "thorax", "left_thigh", "right_thigh")
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip = j[f"{side}_thigh"]
        sphere("pelvis", f"{side}_buttock", back_of(trunk, np.array([sign * 0.08, 0, hip[2] - 0.01])), 0.07)
        sphere(
            "thorax",
            f"{side}_scapula",
            back_of(trunk, np.array([sign * 0.09, 0, j[f"{side}_upper_arm"][2] - 0.06])),
            0.06,
        )
        calf = j[f"{side}_shank"] + 0.35 * body.axis_vector(f"{side}_shank")
        sphere(f"{side}_shank", f"{side}_calf", back_of(body.vertices_of(f"{side}_shank"), calf), 0.04)
        foot = body.vertices_of(f"{side}_foot")
        heel = foot[foot[:, 1].argmax()]
        sphere(f"{side}_foot", f"{side}_heel", heel, 0.025)
        # Limbs turn about their own axis: a sphere about that axis meets the bed in the same way however they lie.
        for segment, along, name in (
            ("upper_arm", 0.95, "elbow"), ("forearm", 0.92, "wrist"), ("hand", 0.55, "hand"),
        ):  # fmt: skip
            full = f"{side}_{segment}"
            points = body.vertices_of(full, *([f"{side}_forearm"] if segment == "upper_arm" else []))
            axis = body.axis_vector(full)
            length = float(np.linalg.norm(axis))
            unit = axis / length
            centre = j[full] + along * axis
            near = points[np.abs((points - centre) @ unit) < 0.02]
            off = near - centre
            radius = float(np.median(np.linalg.norm(off - np.outer(off @ unit, unit), axis=1)))
            centre = centre + (off.mean(0) - (off.mean(0) @ unit) * unit)
            bodies[full].add_geom(
                name=f"human_proxy_{side}_{name}", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre - j[full],
                size=[radius, 0, 0], mass=0, group=HIDDEN_GROUP, condim=3, **BED_ONLY,
            )  # fmt: skip
    head = body.vertices_of("head")
    occiput = head[head[:, 1].argmax()]
    sphere("head", "occiput", np.array([0, occiput[1], occiput[2]]), 0.07)


def _add_rigid_surface(spec: mujoco.MjSpec, body: Body, bodies: dict[str, mujoco.MjsBody]) -> None:
    """Convex hulls of the segments without a shell: robot contact there is a result too (off target)."""
    soft = set(SOFT_SEGMENTS.values())
    for segment in body.segments:
        if segment in soft or segment.endswith("clavicle"):
            continue
        points = _rigid_points(body, segment)
        if len(points) > 400:
            points = points[:: len(points) // 400]
        name = f"human_hull_{segment}"
        spec.add_mesh(name=name, uservert=(points - body.joint_centre[segment]).ravel(), maxhullvert=40)
        bodies[segment].add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, group=HIDDEN_GROUP, condim=3,
            friction=[0.5, 0.005, 0.0001], solref=[0.01, 1], solimp=[0.95, 0.99, 0.001, 0.5, 2], priority=1,
            **ROBOT_ONLY,
        )  # fmt: skip


def _rigid_points(body: Body, segment: str) -> Array:
    """(n, 3) surface points that a segment's hull encloses. Chest and pelvis end where the soft belly begins."""
    low, high = belly_span(body)
    if segment == "thorax":
        points = body.vertices_of("thorax", "left_clavicle", "right_clavicle")
        return points[points[:, 2] > high]
    if segment == "pelvis":
        # The rig gives the pelvis few vertices; the top of the thighs and the lowest abdomen close it.
        points = body.vertices_of("pelvis", "left_thigh", "right_thigh", "abdomen")
        return points[(points[:, 2] > low - 0.13) & (points[:, 2] < low)]
    return body.vertices_of(segment)
