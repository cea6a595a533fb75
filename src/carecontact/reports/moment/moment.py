"""Where, how hard and how deep the robot pressed at the moment that a trial's picture shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.recording.schema import Recording
from carecontact.regions import REGIONS, LimbSight
from carecontact.scoring.region import points_in_region, surface_normal

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Moment:
    index: int
    """Number of the physics step."""
    time_s: float
    segment: str
    force_in_world: F64
    """(3,) [N] of the robot on the segment"""
    centroid_in_world: F64
    """(3,) [m] of the contact, weighted by force"""
    centroid_in_region: F64
    """(3,) [m] in the frame of the trial's region"""
    outward_in_world: F64
    """(3,) unit normal of the region's surface there"""
    depth_m: float | None
    """Largest indentation of the region; None where another segment was pressed."""
    deepest: tuple[float, float] | None
    """Largest indentation of the region in the whole trial [m], and when [s]; None as for ``depth_m``."""

    @property
    def force_n(self) -> float:
        return float(np.linalg.norm(self.force_in_world))


def region_column(recording: Recording) -> int:
    """Return the column of the trial's region in arrays of all regions."""
    spec = recording.header.spec
    return recording.header.regions.index(spec.protocol.task(spec.task_id).region)


def region_poses(recording: Recording) -> F64:
    """(T, 7) of the trial's region in the world."""
    return recording["scorer/region_pose_in_world"][:, region_column(recording)].astype(np.float64)


def peak_moment(recording: Recording) -> Moment | None:
    """Return the largest force on the target, or on anything if the target was never touched; None without a touch."""
    force = recording["scorer/force_human_from_robot_in_world"]
    pushed = np.flatnonzero((force != 0).any(axis=(0, 2)))
    if not pushed.size:
        return None
    spec = recording.header.spec
    region = spec.protocol.task(spec.task_id).region
    target = recording.header.segments.index(REGIONS[region].segment)
    columns = [target] if target in pushed else pushed.tolist()
    norms = np.linalg.norm(force[:, columns].astype(np.float64), axis=-1)
    index, place = np.unravel_index(int(norms.argmax()), norms.shape)
    column = columns[int(place)]
    centroid = recording["scorer/centroid_in_world"][index, column].astype(np.float64)
    pose = region_poses(recording)[index]
    inside = points_in_region(centroid[None], pose[None])
    turn = np.stack([points_in_region(pose[:3] + axis, pose[None])[0] for axis in np.eye(3)])
    outward = surface_normal(inside, recording["scorer/region_size_m"][region_column(recording)])[0]
    return Moment(
        index=int(index),
        time_s=float(recording["scorer/time_s"][index]),
        segment=recording.header.segments[column],
        force_in_world=force[index, column].astype(np.float64),
        centroid_in_world=centroid,
        centroid_in_region=inside[0],
        outward_in_world=turn @ outward,
        depth_m=_depth(recording, float(recording["scorer/time_s"][index])) if column == target else None,
        deepest=_deepest(recording) if column == target else None,
    )


def _depth(recording: Recording, time_s: float) -> float | None:
    times = recording["scorer/period_time_s"]
    if not times.size:
        return None
    period = min(int(np.searchsorted(times, time_s)), len(times) - 1)
    return float(recording["scorer/indentation_m"][period, region_column(recording)])


def _deepest(recording: Recording) -> tuple[float, float] | None:
    times = recording["scorer/period_time_s"]
    if not times.size:
        return None
    depths = recording["scorer/indentation_m"][:, region_column(recording)]
    period = int(depths.argmax())
    return float(depths[period]), float(times[period])


def ends_of(region: str) -> tuple[str, str]:
    """Return words for the directions against and along the region's x axis."""
    sight = REGIONS[region].sight
    return ("toward the trunk", "toward the hand") if isinstance(sight, LimbSight) else (
        "toward the feet", "toward the head",
    )  # fmt: skip
