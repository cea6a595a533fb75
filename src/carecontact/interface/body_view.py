"""Finds where a body region is from one observation, for the shipped policies and for the measurement of perception.

Key points give its joints, and the point cloud gives its surface. The joints lie a little under the surface that the
camera sees. The line between them is moved onto the middle of the visible limb, and the top surface above that line is
read from the person's points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.regions import REGIONS, LimbSight, TrunkSight

F64 = npt.NDArray[np.float64]

LANDMARK = {
    f"{side} {joint}": first + offset
    for joint, first in {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27}.items()
    for offset, side in enumerate(("left", "right"))
}
"""Index of each key point in the order of MediaPipe Pose."""
JOINT_DEPTH_M = {"shoulder": 0.045, "elbow": 0.040, "wrist": 0.025, "hip": 0.090, "knee": 0.065, "ankle": 0.050}
"""Depth of a joint's centre behind the skin in front of it, along the line of sight; for adults, rounded, assumed. The
knee's is that of the shipped bodies from the front, 63 to 83 mm; the ankle's is half of the foot's joint from front to
heel. No shipped region uses these two."""
MIN_VISIBILITY = 0.5
"""Key points that the estimator rates lower count as hidden."""
LIMB_LENGTH_M = (0.15, 0.40)
LEG_LENGTH_M = (0.15, 0.60)  # a thigh or a shank
TRUNK_LENGTH_M = (0.30, 0.70)
"""Lengths from small children to very tall adults; a skeleton outside them is not a person's."""
MIN_COLUMN_POINTS = 5
COLUMN_RADIUS_M = 0.012
SEARCH_HALF_WIDTH_M, TRUNK_SEARCH_M = 0.07, 0.25
"""Half widths of the strips round a limb's line, and round the trunk's, in which the outline is looked for."""
MAX_SHIFT_M = 0.04
PROFILE = np.linspace(0.1, 0.9, 17)
"""Fractions of the region's length at which the top surface is read."""
MIN_PROFILE = 9
HAND_REACH_M, HAND_OVER_TIP_M, HALF_SCRUB_M = 0.12, 0.035, 0.025
"""From the tool to the corners of the robot's hand, which touched the chests of heavy bodies there; height of its
underside over the tip; half of what a scrub has to cover."""
MIN_REGION_M = 0.10
"""Least length of a limb's region where the chest leaves little room: a scrub fits into it."""
CROWDED = np.linspace(0.95, 0.2, 39)
"""Places along a limb at which the chest is looked for, from the next joint to the trunk."""


class PerceptionFailure(ContractError):
    """A region cannot be found in an observation; the message gives the reason."""


def person_points(view: CameraView) -> F64:
    """Return the (N, 3) points of the person's surface in base [m]; the view must hold depth, points and masks."""
    return points_of(view, "human")


def points_of(view: CameraView, name: str) -> F64:
    """Return the (N, 3) points of the mask ``name`` in base [m]; the view must hold depth, points and masks."""
    # A view's ``points`` are its pixels with a depth, row by row.
    assert view.points is not None
    assert view.depth is not None
    assert view.masks is not None
    # compress takes a fraction of the time of an index of booleans.
    own = np.compress(np.isfinite(view.depth).ravel(), view.masks[name].ravel())
    return np.compress(own, view.points, 0).astype(np.float64)


def joint_centre(view: CameraView, name: str) -> F64:
    """Return a joint's (3,) centre in base [m]: the surface under the key point, moved on along the line of sight.

    Raises PerceptionFailure if no key point has this name, no person was found, or the key point is hidden or has no
    depth.
    """
    assert view.landmarks is not None
    if name not in LANDMARK:
        raise PerceptionFailure(f"no key point is named {name!r}; valid: {', '.join(LANDMARK)}")
    index = LANDMARK[name]
    visibility = float(view.landmarks[index, 2])
    if not np.isfinite(visibility):
        raise PerceptionFailure("nobody was found in the image")
    if visibility < MIN_VISIBILITY:
        raise PerceptionFailure(f"{name} is hidden (visibility {visibility:.2f} < {MIN_VISIBILITY})")
    surface = np.full(3, np.nan) if view.landmarks_in_base is None else view.landmarks_in_base[index].astype(np.float64)
    if not np.isfinite(surface).all():
        raise PerceptionFailure(f"{name} has no depth")
    sight = surface - view.pose_camera_in_base[:3, 3]
    return surface + JOINT_DEPTH_M[name.split()[1]] * sight / np.linalg.norm(sight)


@dataclass(frozen=True, kw_only=True)
class RegionGeometry:
    """One region as seen, in base. Its axis runs from proximal to distal (abdomen: from caudal to cranial)."""

    region: str
    centre_m: F64
    """(3,) point of the skin above the middle of the axis [m]."""
    axis: F64
    """(3,) unit vector along the skin."""
    normal: F64
    """(3,) unit vector out of the skin, orthogonal to the axis."""
    lateral: F64
    """(3,) horizontal unit vector, normal x axis."""
    radius_m: float
    """Half the visible width."""
    half_length_m: float
    profile_m: F64
    """(K, 2) distance along the axis from the centre, and height of the skin over the line along the axis [m]."""
    support_height_m: float | None
    """Height in base of what the limb lies on, as seen beside the limb; None if it is hidden."""

    def surface(self, along_m: float) -> F64:
        """Return the (3,) point of the skin at a distance along the axis from the centre [m].

        Beyond what was seen, the profile keeps its last height.
        """
        rise = float(np.interp(along_m, self.profile_m[:, 0], self.profile_m[:, 1]))
        return self.centre_m + along_m * self.axis + np.array([0.0, 0.0, rise])


def region_from_observation(
    observation: Observation, region: str, *, side: str = "right", camera: str = "overhead"
) -> RegionGeometry:
    """Return where a region is seen.

    Args:
        observation: must hold depth, points, masks and landmarks of ``camera``.
        region: name of the region.
        side: ``right`` or ``left``, the person's own; it makes no difference for the abdomen.
        camera: name of the camera.

    Raises PerceptionFailure if a modality is missing, key points are hidden or cannot be a person's, or the surface has
    too few points.
    """
    view = observation.cameras.get(camera)
    if view is None or view.landmarks is None or view.masks is None or view.points is None or view.depth is None:
        raise PerceptionFailure(f"camera {camera}: depth, points, masks and landmarks are needed")
    person = person_points(view)
    match REGIONS[region].sight:
        case TrunkSight() as sight:
            lower, upper = (
                (joint_centre(view, f"left {joint}") + joint_centre(view, f"right {joint}")) / 2
                for joint in sight.joints
            )
            trunk = _checked_length(upper - lower, TRUNK_LENGTH_M, "trunk")
            lower, upper = _at_centres(sight, lower, upper)
            middle = lower + sight.middle * (upper - lower)
            half = 0.5 * sight.length * trunk
            along = (upper - lower) / trunk
            start, end, search = middle - half * along, middle + half * along, TRUNK_SEARCH_M
        case LimbSight() as sight:
            start, end = (joint_centre(view, f"{side} {joint}") for joint in sight.joints)
            limits = LEG_LENGTH_M if "knee" in sight.joints else LIMB_LENGTH_M
            _checked_length(end - start, limits, f"{side} {region.replace('_', ' ')}")
            start, end = _at_centres(sight, start, end)
            start, search = start + free_from(sight, person, start, end) * (end - start), SEARCH_HALF_WIDTH_M
        case None:
            raise PerceptionFailure(f"no joints are known between which the {region.replace('_', ' ')} lies")
    return _fit(region, person, points_of(view, "bed"), start, end, search)


def free_from(sight: LimbSight, person: F64, start: F64, end: F64) -> float:
    """Share of a limb's line at which its region begins: where the row says, or on a person whose chest is in the way
    of a hand there, so far toward the next joint that half a scrub before the region's middle is free."""
    length = float(np.linalg.norm((end - start)[:2]))
    if sight.free_from == 0 or length < MIN_REGION_M:
        return sight.free_from
    person = _around(person, start, end, HAND_REACH_M)
    for share in CROWDED[CROWDED > sight.free_from]:
        place = start + share * (end - start)
        beside = person[np.hypot(person[:, 0] - place[0], person[:, 1] - place[1]) < HAND_REACH_M, 2]
        top = _column(person, place)
        if len(beside) and np.percentile(beside, 98) - top > HAND_OVER_TIP_M:
            wanted = 2 * (share + HALF_SCRUB_M / length) - 1
            return float(np.clip(wanted, sight.free_from, max(1 - MIN_REGION_M / length, sight.free_from)))
    return sight.free_from


def _at_centres(sight: LimbSight | TrunkSight, first: F64, second: F64) -> tuple[F64, F64]:
    ahead, along = sight.ahead, second - first
    return first + ahead[0] * along, second + ahead[1] * along


def _checked_length(vector: F64, limits: tuple[float, float], what: str) -> float:
    length = float(np.linalg.norm(vector))
    if not limits[0] <= length <= limits[1]:
        raise PerceptionFailure(f"{what} seems {length:.2f} m long, expected {limits[0]} to {limits[1]} m")
    return length


def _fit(region: str, person: F64, bed: F64, start: F64, end: F64, search: float) -> RegionGeometry:
    length = float(np.linalg.norm((end - start)[:2]))
    if length < 0.5 * float(np.linalg.norm(end - start)):
        raise PerceptionFailure(f"the {region.replace('_', ' ')} points up at the camera")
    direction = np.append((end - start)[:2] / length, 0.0)
    lateral = np.array([-direction[1], direction[0], 0.0])
    radius, shift = _silhouette(region, person, start, direction, lateral, length, search)
    if isinstance(REGIONS[region].sight, LimbSight):
        # Across a limb, its outline is more accurate than key points.
        start = start + shift * lateral
    above = _around(person, start, start + length * direction, COLUMN_RADIUS_M)
    heights = np.array([_column(above, start + f * length * direction) for f in PROFILE])
    seen = np.isfinite(heights)
    if seen.sum() < MIN_PROFILE:
        raise PerceptionFailure(
            f"the {region.replace('_', ' ')}'s top is seen at {seen.sum()} of {len(PROFILE)} places"
        )
    distance = (PROFILE - 0.5) * length
    slope, _ = np.polyfit(distance[seen], heights[seen], 1)
    middle = np.interp(0.0, distance[seen], heights[seen])
    centre = np.append((start + 0.5 * length * direction)[:2], middle)
    axis = direction + np.array([0.0, 0.0, slope])
    axis /= np.linalg.norm(axis)
    rise = heights[seen] - (middle + slope * distance[seen])
    normal = np.cross(axis, lateral)
    return RegionGeometry(
        region=region,
        centre_m=centre,
        axis=axis,
        normal=normal,
        lateral=lateral,
        radius_m=radius,
        half_length_m=0.5 * length,
        profile_m=np.column_stack([distance[seen] / (axis @ direction), rise]),
        support_height_m=_support(bed, start, direction, lateral, length, radius),
    )


def _silhouette(
    region: str, person: F64, start: F64, direction: F64, lateral: F64, length: float, search: float
) -> tuple[float, float]:
    """Return the visible limb's half width near its middle, and how far its middle lies beside the joints' line [m]."""
    offset = person - start
    along, across = offset @ direction, offset @ lateral
    strip = across[(np.abs(along - 0.5 * length) < 0.2 * length) & (np.abs(across) < search)]
    if len(strip) < MIN_COLUMN_POINTS:
        raise PerceptionFailure(f"no surface near the {region.replace('_', ' ')} ({len(strip)} points)")
    low, high = np.percentile(strip, [2, 98])
    shift = float(low + high) / 2
    if isinstance(REGIONS[region].sight, LimbSight) and abs(shift) > MAX_SHIFT_M:
        raise PerceptionFailure(f"key points miss the {region.replace('_', ' ')} by {abs(shift) * 1000:.0f} mm")
    return float(high - low) / 2, shift


def _around(person: F64, start: F64, end: F64, reach_m: float) -> F64:
    """Return the points of the person, in their order, that are no farther than ``reach_m`` from the upright box round
    two places; all that are so near to any place between the two are among them."""
    low, high = np.minimum(start, end)[:2] - reach_m - 1e-6, np.maximum(start, end)[:2] + reach_m + 1e-6
    return person[((person[:, :2] >= low) & (person[:, :2] <= high)).all(1)]


def _column(person: F64, place: F64) -> float:
    """Return the height of the top surface at a place: the median of the upper third of points within COLUMN_RADIUS_M.

    NaN means that there are too few points.
    """
    near = np.hypot(person[:, 0] - place[0], person[:, 1] - place[1]) < COLUMN_RADIUS_M
    heights = np.sort(person[near, 2])
    return float(np.median(heights[-max(1, len(heights) // 3) :])) if len(heights) >= MIN_COLUMN_POINTS else np.nan


def _support(bed: F64, start: F64, direction: F64, lateral: F64, length: float, radius: float) -> float | None:
    offset = bed - start
    along, across = offset @ direction, np.abs(offset @ lateral)
    beside = (along > 0) & (along < length) & (across > radius) & (across < radius + 0.10)
    return float(np.median(bed[beside, 2])) if beside.sum() >= MIN_COLUMN_POINTS else None
