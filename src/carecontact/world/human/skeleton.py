"""Segments as bodies with hinges, inertias, bed proxies and the rigid surface that a robot can touch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import mujoco
import numpy as np

from carecontact.errors import SceneError
from carecontact.regions import REGIONS, Tube
from carecontact.world.human.anthropometry import segment_inertias
from carecontact.world.human.bed_contact import bed_proxies
from carecontact.world.human.body import PARENT, Array, Body
from carecontact.world.human.joints import Hinge, hinges
from carecontact.world.human.pose import FIXED_SEGMENTS, lying_pose_deg, rotation_from_bind
from carecontact.world.human.shell import belly_half_width, belly_span

# Collision bits. The robot has contype 1; bed and arm board have conaffinity 3 and so meet both robot and proxies.
ROBOT_ONLY = {"contype": 0, "conaffinity": 1}
BED_ONLY = {"contype": 2, "conaffinity": 0}
HIDDEN_GROUP = 3
ROOT_JOINT = "human_root"
LIMB_REACH_M = 0.09
"""Surface nearer to a limb's axis than this is the limb's."""


def body_name(segment: str) -> str:
    return f"human_{segment}"


def add_skeleton(
    spec: mujoco.MjSpec,
    body: Body,
    *,
    root_position: Array,
    root_quat: Array,
    soft_regions: Iterable[str],
) -> list[Hinge]:
    """Add every segment under a free root; returns the hinges in the order of their joints.

    A segment's mass counts its shell: the inertia that the shell's law has is that of its motion against the bone.

    ``soft_regions``: those with a shell, which covers part of their segments' surface.
    """
    soft = {REGIONS[region].segment: region for region in soft_regions}
    inertias = segment_inertias(body)
    rows, pose = hinges(body), lying_pose_deg(body, 0.0)
    bodies: dict[str, mujoco.MjsBody] = {}
    for segment in body.segments:
        parent = PARENT[segment]
        at = body.joint_centre[segment]
        if parent is None:
            made = spec.worldbody.add_body(name=body_name(segment), pos=root_position, quat=root_quat)
            made.add_freejoint(name=ROOT_JOINT)
        else:
            made = bodies[parent].add_body(name=body_name(segment), pos=at - body.joint_centre[parent])
        bodies[segment] = made
        row = inertias[segment]
        made.explicitinertial = True
        tensor = row.axes @ np.diag(row.moments_kgm2) @ row.axes.T
        made.mass = row.mass_kg
        made.ipos = row.centre_m - at
        made.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        if segment in FIXED_SEGMENTS:
            turn = np.zeros(4)
            mujoco.mju_mat2Quat(turn, rotation_from_bind(rows, segment, pose).ravel())
            made.quat = turn
            continue
        for hinge in rows:
            if hinge.segment == segment:
                _add_hinge(made, hinge)
    _add_bed_proxies(body, bodies)
    _add_rigid_surface(spec, body, bodies, soft)
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
    for proxy in bed_proxies(body):
        bodies[proxy.segment].add_geom(
            name=f"human_proxy_{proxy.name}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[proxy.radius_m, 0, 0], mass=0,
            pos=proxy.centre - body.joint_centre[proxy.segment], group=HIDDEN_GROUP, condim=3, **BED_ONLY,
        )  # fmt: skip


def _add_rigid_surface(
    spec: mujoco.MjSpec, body: Body, bodies: dict[str, mujoco.MjsBody], soft: dict[str, str]
) -> None:
    """Convex hulls of the segments without a shell: robot contact there is a result too (off target)."""
    for name, segment, points in _hulls(body, soft):
        if len(points) > 400:
            points = points[:: len(points) // 400]
        name = f"human_hull_{name}"
        spec.add_mesh(name=name, uservert=(points - body.joint_centre[segment]).ravel(), maxhullvert=40)
        bodies[segment].add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, group=HIDDEN_GROUP, condim=3,
            friction=[0.5, 0.005, 0.0001], solref=[0.01, 1], solimp=[0.95, 0.99, 0.001, 0.5, 2], priority=1,
            **ROBOT_ONLY,
        )  # fmt: skip


def rigid_points(body: Body, segment: str) -> Array:
    """(n, 3) points of the surface that the robot touches where the segment has no soft shell, in the mesh frame.

    Raises SceneError for a segment without a surface of its own.
    """
    found = [points for _, owner, points in _hulls(body, {}) if owner == segment]
    if not found:
        raise SceneError(f"segment {segment!r} has no surface of its own that a robot could touch")
    return np.concatenate(found)


def _hulls(body: Body, soft: dict[str, str]) -> Iterator[tuple[str, str, Array]]:
    """(name, segment, points (n, 3)) of every rigid hull: what no shell covers, so that nothing is open.

    ``soft``: segment -> its soft region.
    """
    low, high = belly_span(body)
    for segment in body.segments:
        if segment.endswith("clavicle"):
            continue
        if segment == "thorax":
            points = body.vertices_of("thorax", "left_clavicle", "right_clavicle")
            yield segment, segment, points[points[:, 2] > high]
        elif segment == "pelvis":
            # The rig gives the pelvis few vertices; the top of the thighs and the lowest abdomen close it.
            points = body.vertices_of("pelvis", "left_thigh", "right_thigh", "abdomen")
            yield segment, segment, points[(points[:, 2] > low - 0.13) & (points[:, 2] < low + 0.005)]
        elif segment == "abdomen":
            trunk = body.vertices_of("thorax", "abdomen", "pelvis")
            trunk = trunk[(trunk[:, 2] > low - 0.01) & (trunk[:, 2] < high + 0.03)]
            yield "left_flank", segment, trunk[trunk[:, 0] > belly_half_width(body) - 0.015]
            yield "right_flank", segment, trunk[trunk[:, 0] < 0.015 - belly_half_width(body)]
            yield "lower_back", segment, trunk[trunk[:, 1] > body.joint_centre["thorax"][1]]
        elif segment in soft and isinstance(tube := REGIONS[soft[segment]].shape, Tube):
            yield from _limb_ends(body, segment, tube)
        else:
            yield segment, segment, body.vertices_of(segment)


def _limb_ends(body: Body, segment: str, tube: Tube) -> Iterator[tuple[str, str, Array]]:
    """A soft limb's rigid ends beside its shell, for example shoulder cap and elbow, or elbow and wrist."""
    side = segment.partition("_")[0]
    start, along = tube.span
    points = body.vertices_of(segment, *(f"{side}_{kind}" for kind in tube.closed_by))
    axis = body.axis_vector(segment)
    share = (points - body.joint_centre[segment]) @ axis / (axis @ axis)
    off = points - body.joint_centre[segment] - share[:, None] * axis
    near = np.linalg.norm(off, axis=1) < LIMB_REACH_M
    yield f"{segment}_near_end", segment, points[near & (share > tube.near_end_from) & (share < start + 0.02)]
    yield f"{segment}_far_end", segment, points[near & (share > along - 0.02) & (share < 1.03)]
