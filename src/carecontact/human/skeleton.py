"""Segments as bodies with hinges, end stops, inertias and the rigid surface that a robot can touch, and the frames of
regions on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from carecontact.errors import SceneError
from carecontact.human.body import CHILD_ALONG, PARENT, Array, Body, kind_of, segment_inertias
from carecontact.human.hulls import (
    BARE_SOLIMP,
    BARE_SOLREF,
    BELLY_FLOOR,
    SOLIMP,
    SOLREF,
    add_plate,
    parted,
    plate_under,
    plates_of,
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

# At the end of its range, a joint resists with a torque that begins at zero and grows with the cube of the angle.
# Engin and Chen 1987, J Biomech Eng 109:318, gave the passive torque of ten elbows beyond their range as a cubic in the
# angle (their coefficients were not read; the form is that of a public database's entry on the paper). Riener and
# Edrich 1999, J Biomech 32:539, use exponentials, which rise in a similar way. The strength of the stop is our choice:
# a limp arm that an examiner's pull swings into its end (``lab.validation.passive_response``) goes at most 5 degrees
# past it, which is the accuracy with which ranges of motion are read. Real ends are softer and begin earlier.

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
    return next(pull for part, pull in PULL_NM.items() if kind_of(hinge).startswith(part)) / REACHED_RAD**3


def past_range(angle_rad: Array, low_rad: Array, high_rad: Array) -> Array:
    """Return how far [rad] angles are past the range: positive past the upper end, negative past the lower."""
    return np.maximum(angle_rad - high_rad, 0.0) + np.minimum(angle_rad - low_rad, 0.0)


def end_stop_nm(past_rad: Array, cubic: Array) -> Array:
    """Return the torque [N m] of end stops, which acts against the angle by which each joint is past its range."""
    return -cubic * past_rad**3


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
    surface = list(_hulls(body, soft))
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
        places = [(plate, _middle(body, surface, plate.name)) for plate in plates_of(segment)]
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
                _add_hinge(spec, made, hinge)
    for proxy in bed_proxies(body):
        place = proxy.centre - body.joint_centre[proxy.segment]
        geom = {"group": HIDDEN_GROUP, "condim": 3, "mass": 0, **BED_ONLY}
        sphere, size = mujoco.mjtGeom.mjGEOM_SPHERE, [proxy.radius_m, 0, 0]
        bodies[proxy.segment].add_geom(name=f"human_proxy_{proxy.name}", type=sphere, size=size, pos=place, **geom)
    for hull in surface:
        # A robot's contact with a hull is recorded too, as contact off the target.
        to = bodies[hull.segment] if hull.plate is None else carriers[hull.plate]
        thinned = hull.points[:: max(len(hull.points) // 400, 1)] - body.joint_centre[hull.segment]
        add_hull(spec, to, f"human_hull_{hull.name}", thinned, friction=0.5, plate=hull.plate is not None)
    return [row for row in rows if row.segment not in FIXED_SEGMENTS]


def _add_hinge(spec: mujoco.MjSpec, to: mujoco.MjsBody, hinge: Hinge) -> None:
    """Add a hinge, and as its end stop a tendon that has no effect inside the hinge's range.

    MuJoCo's own joint limits would not do: their resistance depends on the inertia of what moves, and they have a
    damper that no human joint has.
    """
    name, cubic = f"human_{hinge.name}", [0.0, 0.0, cubic_nm_rad3(hinge.name)]
    to.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=hinge.axis,
        ref=np.radians(hinge.bind_deg),
        limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        range=np.radians(hinge.range_deg),
        stiffness=[hinge.stiffness_nm_rad, 0, 0],
        springref=np.radians(hinge.bind_deg),
        damping=[hinge.damping_nms_rad, 0, 0],
        armature=0.002,
    )
    stop = spec.add_tendon(name=stop_name(hinge.name), springlength=np.radians(hinge.range_deg), stiffness=cubic)
    stop.wrap_joint(name, 1.0)


@dataclass(frozen=True, kw_only=True)
class _Hull:
    """A convex part of the surface that no shell covers."""

    name: str
    segment: str
    points: Array
    """(n, 3) mesh frame"""
    plate: str | None = None
    """Name of the plate that carries it; None means the bone."""


def _middle(body: Body, surface: list[_Hull], plate: str) -> Array:
    """Return the middle (3,) of a plate's hull in the mesh frame."""
    if plate == BELLY_FLOOR:  # the core's hulls are made later, round this axis
        return np.array([0.0, body.joint_centre["thorax"][1], sum(belly_span(body)) / 2])
    points = np.concatenate([hull.points for hull in surface if hull.plate == plate])
    return (points.min(0) + points.max(0)) / 2


def add_hull(
    spec: mujoco.MjSpec, to: mujoco.MjsBody, name: str, points: Array, *, friction: float, plate: bool
) -> None:
    """Add the convex hull of points (n, 3) in a body's frame that a robot can touch; ``plate``: a plate carries it."""
    spec.add_mesh(name=name, uservert=points.ravel(), maxhullvert=40)
    solref, solimp = (SOLREF, SOLIMP) if plate else (BARE_SOLREF, BARE_SOLIMP)
    to.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        mass=0,
        group=HIDDEN_GROUP,
        condim=3,
        friction=[friction, 0.005, 0.0001],
        solref=list(solref),
        solimp=list(solimp),
        priority=1,
        **ROBOT_ONLY,
    )


def rigid_points(body: Body, segment: str) -> Array:
    """Return the points (n, 3), in the mesh frame, of the surface that the robot touches on a segment without a shell.

    Raises SceneError for a segment without a surface of its own.
    """
    low, high = belly_span(body)
    match segment:
        case "left_clavicle" | "right_clavicle":
            raise SceneError(f"segment {segment!r} has no surface of its own that a robot could touch")
        case "thorax":
            points = body.vertices_of("thorax", "left_clavicle", "right_clavicle")
            return points[points[:, 2] > high]
        case "pelvis":
            # The rig assigns few vertices to the pelvis: the top of the thighs and the lowest abdomen complete it.
            points = body.vertices_of("pelvis", "left_thigh", "right_thigh", "abdomen")
            return points[(points[:, 2] > low - 0.13) & (points[:, 2] < low + 0.005)]
        case "abdomen":
            trunk = _lower_trunk(body)
            beside = np.abs(trunk[:, 0]) > belly_half_width(body) - 0.015
            return trunk[beside | (trunk[:, 1] > body.joint_centre["thorax"][1])]
        case _:
            return body.vertices_of(segment)


def _lower_trunk(body: Body) -> Array:
    low, high = belly_span(body)
    trunk = body.vertices_of("thorax", "abdomen", "pelvis")
    return trunk[(trunk[:, 2] > low - 0.01) & (trunk[:, 2] < high + 0.03)]


def _hulls(body: Body, soft: dict[str, str]) -> Iterator[_Hull]:
    """Yield every hull: together they cover all that no shell covers, so that the surface has no hole.

    ``soft``: segment -> its soft region.
    """
    apart = parted(body)
    for segment in body.segments:
        shape = REGIONS[soft[segment]].shape if segment in soft else None
        names = [] if isinstance(shape, Tube) else [p.name for p in plates_of(segment) if p.name in apart]
        for name in sorted(names):
            yield _Hull(name=name, segment=segment, points=apart[name], plate=name)
        if segment == "abdomen":
            trunk = _lower_trunk(body)
            back = trunk[trunk[:, 1] > body.joint_centre["thorax"][1]]
            yield _Hull(name="lower_back", segment=segment, points=back)
        elif isinstance(shape, Tube):
            yield from _limb_ends(body, segment, shape)
        elif not names and not segment.endswith("clavicle"):
            yield _Hull(name=segment, segment=segment, points=body.vertices_of(segment), plate=plate_under(segment))


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
    size = np.array([shell.length_m, shell.radius_m, shell.axis_depth_m])
    return RegionFrame(origin=shell.frame_origin, axes=shell.frame, size_m=size)


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
    size = np.array([high - low, np.ptp(width) / 2, np.ptp(height) / 2])
    return RegionFrame(origin=body.joint_centre[segment] + centre, axes=np.stack([x, y, z], 1), size_m=size)


def upward_in_bind(body: Body, segment: str, turn: ArmTurn = NOT_TURNED) -> Array:
    """Return the direction (3,) in the segment's bind frame that points up in the nominal lying pose."""
    rows, pose = hinges(body), lying_pose_deg(body, MIDDLE_ARM_DEG, turn)
    rotation, _ = segment_pose(body, rows, pose, trunk_rotation(body), segment)
    return rotation.T @ np.array([0.0, 0.0, 1.0])


def _axis(body: Body, segment: str) -> Array:
    kind = segment.partition("_")[2]
    if kind in CHILD_ALONG or kind == "hand":
        return body.direction(segment)
    return FOOT_AXIS if kind == "foot" else TRUNK_AXIS
