"""Segments as bodies with hinges, end stops, inertias and the rigid surface that a robot can touch, and the frames of
regions on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from carecontact.errors import SceneError
from carecontact.human.body import CHILD_ALONG, PARENT, Array, Body, segment_inertias
from carecontact.human.hulls import (
    BARE_SOLIMP,
    BARE_SOLREF,
    BELLY_FLOOR,
    SIDEWAYS,
    SOLIMP,
    SOLREF,
    add_plate,
    parted,
    plate_under,
    plates_of,
    trunk_sides,
    without_plates,
)
from carecontact.human.joints import Hinge, hinges
from carecontact.human.pose import (
    FIXED_SEGMENTS,
    MIDDLE_ARM_DEG,
    NOT_TURNED,
    ArmTurn,
    bed_proxies,
    lying_pose_deg,
    rotation_from_bind,
    segment_pose,
    trunk_rotation,
)
from carecontact.human.shell import Shell, belly_half_width, belly_span
from carecontact.interface.regions import REGIONS, Tube

# How a joint resists at the end of its range: a torque that begins there at zero and grows with the cube of the angle.
#
# Engin and Chen 1987, J Biomech Eng 109:318, gave the passive torque of ten elbows beyond their range as a cubic in the
# angle (their coefficients were not read; the form is that of a public database's entry on the paper). Riener and
# Edrich 1999, J Biomech 32:539, use exponentials, which rise in a similar way. The strength of the stop is our choice:
# a limp arm that an examiner's pull swings into its end (``validation.passive_response``) goes at most 5 degrees past
# it, which is the accuracy with which ranges of motion are read. Real ends are softer and begin earlier.

REACHED_RAD = float(np.radians(5.0))
PULL_NM = {
    "upper_arm": 85.0, "forearm_flexion": 18.0, "forearm_supination": 3.0, "hand": 2.3, "neck": 6.0, "thigh": 30.0,
    "shank": 15.0, "foot": 10.0, "abdomen": 60.0, "thorax": 60.0,
}  # fmt: skip
"""Part, or part and motion -> torque [N m] at REACHED_RAD past the range; our choice. The values of upper arm and hand
keep limp arms of all nine bodies within this angle: the arms of the lightest women and the hands of the heaviest men
swing the farthest."""


def stop_name(hinge: str) -> str:
    """Return the name of the tendon that is a hinge's end stop."""
    return f"human_stop_{hinge}"


def cubic_nm_rad3(hinge: str) -> float:
    """Return the coefficient [N m/rad^3] of a hinge's end stop, by the hinge's name with or without the side."""
    kind = hinge.removeprefix("left_").removeprefix("right_")
    return next(pull for part, pull in PULL_NM.items() if kind.startswith(part)) / REACHED_RAD**3


def add_end_stop(spec: mujoco.MjSpec, hinge: Hinge) -> None:
    """Add a tendon over the hinge that has no effect inside the hinge's range.

    MuJoCo's own joint limits would not do: their resistance depends on the inertia of what moves, and they have a
    damper that no human joint has.
    """
    stop = spec.add_tendon(
        name=stop_name(hinge.name), springlength=np.radians(hinge.range_deg),
        stiffness=[0.0, 0.0, cubic_nm_rad3(hinge.name)],
    )  # fmt: skip
    stop.wrap_joint(f"human_{hinge.name}", 1.0)


def past_range(angle_rad: Array, low_rad: Array, high_rad: Array) -> Array:
    """Return how far [rad] angles are past the range: positive past the upper end, negative past the lower one, else
    zero.
    """
    return np.maximum(angle_rad - high_rad, 0.0) + np.minimum(angle_rad - low_rad, 0.0)


def end_stop_nm(past_rad: Array, cubic: Array) -> Array:
    """Return the torque [N m] of end stops, which acts against the angle by which each joint is past its range."""
    return -cubic * past_rad**3


# Segments as bodies with hinges, inertias, bed proxies and the rigid surface that a robot can touch.

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


# Place and size of a region on a body: the frame in which a tool's path over the region is measured.

MIDDLE_SHARE = 0.1
"""Share of a rigid region's length, either way from its middle, in which its radii are measured."""
TRUNK_AXIS, FOOT_AXIS = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
"""Axes, in the mesh frame, of segments that have no next joint: toward the head, and from heel to toe."""


@dataclass(frozen=True, kw_only=True)
class RegionFrame:
    """A region's frame and size, in the mesh frame of the bind pose."""

    origin: Array
    """(3,) middle of the region's axis [m]"""
    axes: Array
    """(3, 3) columns x along the axis, y, z outward, which is up in the lying pose"""
    size_m: Array
    """(3,) length along x, mean radius (abdomen: half width), radius along z at the middle"""


def soft_frame(shell: Shell) -> RegionFrame:
    """Return the frame of a region with a shell."""
    return RegionFrame(
        origin=shell.frame_origin, axes=shell.frame,
        size_m=np.array([shell.length_m, shell.radius_m, shell.axis_depth_m]),
    )  # fmt: skip


def rigid_frame(body: Body, region: str, turn: ArmTurn = NOT_TURNED) -> RegionFrame:
    """Return the frame of a region without a shell: the whole segment, measured on its rigid surface.

    Raises SceneError for a segment without a surface.
    """
    segment = REGIONS[region].segment
    x = _axis(body, segment)
    outward = upward_in_bind(body, segment, turn)
    z = outward - (outward @ x) * x
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    points = rigid_points(body, segment) - body.joint_centre[segment]
    along = points @ x
    low, high = along.min(), along.max()
    near = points[np.abs(along - (low + high) / 2) <= MIDDLE_SHARE * (high - low)]
    width, height = near @ y, near @ z
    # The axis runs through the middle of the section, not through the joint.
    centre = (low + high) / 2 * x + (width.min() + width.max()) / 2 * y + (height.min() + height.max()) / 2 * z
    return RegionFrame(
        origin=body.joint_centre[segment] + centre, axes=np.stack([x, y, z], 1),
        size_m=np.array([high - low, np.ptp(width) / 2, np.ptp(height) / 2]),
    )  # fmt: skip


def upward_in_bind(body: Body, segment: str, turn: ArmTurn = NOT_TURNED) -> Array:
    """Return the direction (3,) in the segment's bind frame that points up in the nominal lying pose, with the comfort
    arm at the middle of its range.
    """
    rows, pose = hinges(body), lying_pose_deg(body, MIDDLE_ARM_DEG, turn)
    rotation, _ = segment_pose(body, rows, pose, trunk_rotation(body), segment)
    return rotation.T @ np.array([0.0, 0.0, 1.0])


def _axis(body: Body, segment: str) -> Array:
    kind = segment.partition("_")[2]
    if kind in CHILD_ALONG or kind == "hand":
        return body.direction(segment)
    return FOOT_AXIS if kind == "foot" else TRUNK_AXIS
