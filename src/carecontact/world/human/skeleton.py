"""Segments as bodies with hinges, inertias, bed proxies and the rigid surface that a robot can touch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from carecontact.errors import SceneError
from carecontact.regions import REGIONS, Tube
from carecontact.world.human.anthropometry import segment_inertias
from carecontact.world.human.bed_contact import bed_proxies
from carecontact.world.human.body import PARENT, Array, Body
from carecontact.world.human.end_stops import add_end_stop
from carecontact.world.human.joints import Hinge, hinges
from carecontact.world.human.parting import parted
from carecontact.world.human.plates import (
    BARE_SOLIMP,
    BARE_SOLREF,
    BELLY_FLOOR,
    SIDEWAYS,
    SOLIMP,
    SOLREF,
    add_plate,
    plate_under,
    plates_of,
    trunk_sides,
    without_plates,
)
from carecontact.world.human.pose import FIXED_SEGMENTS, lying_pose_deg, rotation_from_bind
from carecontact.world.human.shell import belly_half_width, belly_span

# Collision bits. The robot has contype 1; bed and arm board have conaffinity 3 and so meet both robot and proxies.
ROBOT_ONLY = {"contype": 0, "conaffinity": 1}
BED_ONLY = {"contype": 2, "conaffinity": 0}
HIDDEN_GROUP = 3
ROOT_JOINT = "human_root"
LIMB_REACH_M = 0.09
"""Surface within this distance of a limb's axis belongs to the limb."""


def body_name(segment: str) -> str:
    return f"human_{segment}"


def add_skeleton(
    spec: mujoco.MjSpec,
    body: Body,
    *,
    root_position: Array,
    root_quat: Array,
    soft_regions: Iterable[str],
    front: Callable[[str, mujoco.MjsBody], mujoco.MjsBody] | None = None,
) -> list[Hinge]:
    """Add every segment under a free root, and return the hinges in the order of their joints.

    A segment's mass includes its shell: the inertia in the shell's law concerns only its motion relative to the bone.

    Args:
        soft_regions: those with a shell, which covers part of their segments' surface.
        front: gives, for a segment and its bone, the body on which the plates of a chest that breathes stand; by
            default the bone.
    """
    soft = {REGIONS[region].segment: region for region in soft_regions}
    inertias = segment_inertias(body)
    rows, pose = hinges(body), lying_pose_deg(body, 0.0)
    apart = parted(body)
    surface = [replace(hull, points=apart.get(hull.name, hull.points)) for hull in _hulls(body, soft)]
    bodies: dict[str, mujoco.MjsBody] = {}
    carriers: dict[str, mujoco.MjsBody] = {}
    for segment in body.segments:
        parent = PARENT[segment]
        at = body.joint_centre[segment]
        if parent is None:
            made = spec.worldbody.add_body(name=body_name(segment), pos=root_position, quat=root_quat)
            made.add_freejoint(name=ROOT_JOINT)
        else:
            made = bodies[parent].add_body(name=body_name(segment), pos=at - body.joint_centre[parent])
        bodies[segment], ahead = made, made if front is None else front(segment, made)
        places = [
            (plate, _belly_middle(body) if plate.name == BELLY_FLOOR else _middle(surface, plate.name))
            for plate in plates_of(segment)
        ]
        made.mass, centre, tensor = without_plates(inertias[segment], places)
        made.explicitinertial, made.ipos = True, centre - at
        made.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        for plate, middle in places:
            carriers[plate.name] = add_plate(ahead if plate.breathes else made, plate, middle - at)
        if segment in FIXED_SEGMENTS:
            turn = np.zeros(4)
            mujoco.mju_mat2Quat(turn, rotation_from_bind(rows, segment, pose).ravel())
            made.quat = turn
            continue
        for hinge in rows:
            if hinge.segment == segment:
                _add_hinge(made, hinge)
                add_end_stop(spec, hinge)
    _add_bed_proxies(body, bodies)
    for hull in surface:
        _add_hull(spec, body, hull, bodies[hull.segment] if hull.plate is None else carriers[hull.plate])
    return [row for row in rows if row.segment not in FIXED_SEGMENTS]


def _add_hinge(to: mujoco.MjsBody, hinge: Hinge) -> None:
    radians = np.radians
    to.add_joint(
        name=f"human_{hinge.name}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis, ref=radians(hinge.bind_deg),
        limited=mujoco.mjtLimited.mjLIMITED_FALSE, range=radians(hinge.range_deg),
        stiffness=[hinge.stiffness_nm_rad, 0, 0], springref=radians(hinge.bind_deg),
        damping=[hinge.damping_nms_rad, 0, 0], armature=0.002,
    )  # fmt: skip


def _add_bed_proxies(body: Body, bodies: dict[str, mujoco.MjsBody]) -> None:
    for proxy in bed_proxies(body):
        bodies[proxy.segment].add_geom(
            name=f"human_proxy_{proxy.name}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[proxy.radius_m, 0, 0], mass=0,
            pos=proxy.centre - body.joint_centre[proxy.segment], group=HIDDEN_GROUP, condim=3, **BED_ONLY,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Hull:
    """A convex part of the surface that no shell covers."""

    name: str
    segment: str
    points: Array
    """(n, 3) mesh frame"""
    plate: str | None = None
    """Name of the plate that carries it; None means the bone."""


def _middle(surface: list[_Hull], plate: str) -> Array:
    """Return the middle (3,) of a plate's hull in the mesh frame."""
    points = np.concatenate([hull.points for hull in surface if hull.plate == plate])
    return (points.min(0) + points.max(0)) / 2


def _belly_middle(body: Body) -> Array:
    """Return the middle (3,) of the abdomen's core in the mesh frame, on its axis: the core's hulls are made later."""
    low, high = belly_span(body)
    return np.array([0.0, body.joint_centre["thorax"][1], (low + high) / 2])


def _add_hull(spec: mujoco.MjSpec, body: Body, hull: _Hull, to: mujoco.MjsBody) -> None:
    """Add a hull to a body. A robot's contact with it is recorded too, as contact off the target."""
    points, name = hull.points, f"human_hull_{hull.name}"
    if len(points) > 400:
        points = points[:: len(points) // 400]
    spec.add_mesh(name=name, uservert=(points - body.joint_centre[hull.segment]).ravel(), maxhullvert=40)
    solref, solimp = (BARE_SOLREF, BARE_SOLIMP) if hull.plate is None else (SOLREF, SOLIMP)
    to.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, group=HIDDEN_GROUP, condim=3,
        friction=[0.5, 0.005, 0.0001], solref=list(solref), solimp=list(solimp), priority=1, **ROBOT_ONLY,
    )  # fmt: skip


def rigid_points(body: Body, segment: str) -> Array:
    """Return the points (n, 3), in the mesh frame, of the surface that the robot touches if the segment has no soft
    shell.

    Raises SceneError for a segment without a surface of its own.
    """
    found = [hull.points for hull in _hulls(body, {}) if hull.segment == segment]
    if not found:
        raise SceneError(f"segment {segment!r} has no surface of its own that a robot could touch")
    return np.concatenate(found)


ARMPIT_M = 0.07
"""Distance below the shoulder's joint at which the shoulder girdle ends and the rib cage begins."""
GIRDLE_SHARE = 0.45
"""Share of the way from the breastbone to the shoulder's joint at which the girdle begins."""


def _hulls(body: Body, soft: dict[str, str]) -> Iterator[_Hull]:
    """Yield every hull: together they cover all that no shell covers, so that the surface has no hole.

    ``soft``: segment -> its soft region.
    """
    low, high = belly_span(body)
    for segment in body.segments:
        if segment.endswith("clavicle"):
            continue
        if segment == "thorax":
            points = body.vertices_of("thorax", "left_clavicle", "right_clavicle")
            yield from _rib_cage(body, points[points[:, 2] > high])
        elif segment == "pelvis":
            # The rig assigns few vertices to the pelvis, so that the top of the thighs and the lowest abdomen complete
            # it.
            points = body.vertices_of("pelvis", "left_thigh", "right_thigh", "abdomen")
            points = points[(points[:, 2] > low - 0.13) & (points[:, 2] < low + 0.005)]
            for side in SIDEWAYS:
                yield _Hull(name=f"{side}_hip", segment=segment, points=trunk_sides(body, points, side),
                            plate=f"{side}_hip")  # fmt: skip
        elif segment == "abdomen":
            trunk = body.vertices_of("thorax", "abdomen", "pelvis")
            trunk = trunk[(trunk[:, 2] > low - 0.01) & (trunk[:, 2] < high + 0.03)]
            for side, outward in SIDEWAYS.items():
                points = trunk[trunk @ outward > belly_half_width(body) - 0.015]
                yield _Hull(name=f"{side}_flank", segment=segment, points=points, plate=f"{side}_flank")
            back = trunk[trunk[:, 1] > body.joint_centre["thorax"][1]]
            yield _Hull(name="lower_back", segment=segment, points=back)
        elif segment in soft and isinstance(tube := REGIONS[soft[segment]].shape, Tube):
            yield from _limb_ends(body, segment, tube)
        else:
            points = body.vertices_of(segment)
            yield _Hull(name=segment, segment=segment, points=points, plate=plate_under(segment))


def _rib_cage(body: Body, points: Array) -> Iterator[_Hull]:
    """Yield hulls of the chest and of the shoulder girdle on either side.

    One hull over all of them would fill the hollow between chest and arm, so that the robot's hand could not come down
    on the upper arm of a heavy body.
    """
    shoulder = body.joint_centre["left_upper_arm"]
    for side in SIDEWAYS:
        mine = trunk_sides(body, points, side)
        above = mine[:, 2] > shoulder[2] - ARMPIT_M
        outside = np.abs(mine[:, 0]) > GIRDLE_SHARE * shoulder[0]
        for part, chosen in (("chest", ~(above & outside)), ("shoulder", above & outside)):
            yield _Hull(name=f"{side}_{part}", segment="thorax", points=mine[chosen], plate=f"{side}_{part}")


def _limb_ends(body: Body, segment: str, tube: Tube) -> Iterator[_Hull]:
    """Yield the rigid ends of a soft limb beside its shell, for example shoulder cap and elbow, or elbow and wrist."""
    plate = plate_under(segment)
    side = segment.partition("_")[0]
    start, along = tube.span
    points = body.vertices_of(segment, *(f"{side}_{kind}" for kind in tube.closed_by))
    axis = body.axis_vector(segment)
    share = (points - body.joint_centre[segment]) @ axis / (axis @ axis)
    off = points - body.joint_centre[segment] - share[:, None] * axis
    near = np.linalg.norm(off, axis=1) < LIMB_REACH_M
    near_end = points[near & (share > tube.near_end_from) & (share < start + 0.02)]
    yield _Hull(name=f"{segment}_near_end", segment=segment, points=near_end, plate=plate)
    far_end = points[near & (share > along - 0.02) & (share < 1.03)]
    yield _Hull(name=f"{segment}_far_end", segment=segment, points=far_end, plate=plate)
