"""The path of the tool in the frame of the trial's region: as it was commanded and as it was reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat
from carecontact.recording.notes import Note
from carecontact.recording.schema import Recording
from carecontact.reports.moment.moment import region_poses
from carecontact.scoring.region import points_in_region

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Paths:
    """P control periods. Positions [m] are in the region's frame, which moves with the bone: x to the hand or the head,
    y across, z outward."""

    time_s: F64
    """(P,) at the end of each period"""
    reached_m: F64
    """(P, 3) of the tool's tip"""
    commanded_m: F64
    """(P, 3) of the target"""
    turned_rad: F64
    """(P,) angle between the commanded and the reached orientation"""
    pose: F64
    """(P, 7) of the region in the world"""


def paths(recording: Recording) -> Paths | None:
    """Return the paths of a trial; None if it ended before its first control period."""
    times = recording["scorer/period_time_s"]
    if not len(times) or not len(recording["scorer/time_s"]):
        return None
    step = np.clip(np.searchsorted(recording["scorer/time_s"], times) - 1, 0, None)
    pose = region_poses(recording)[step]
    tool = recording["scorer/pose_tcp_in_world"][step].astype(np.float64)
    target = recording["scorer/target_in_base"].astype(np.float64)
    base = np.array(recording.header.pose_base_in_world)
    turn = matrix_from_quat(base[3:])
    wanted = turn @ matrix_from_quat(target[:, 3:])
    trace = np.einsum("nij,nij->n", wanted, matrix_from_quat(tool[:, 3:]))
    return Paths(
        time_s=times.astype(np.float64),
        reached_m=points_in_region(tool[:, :3], pose),
        commanded_m=points_in_region(target[:, :3] @ turn.T + base[:3], pose),
        turned_rad=np.arccos(np.clip((trace - 1) / 2, -1, 1)),
        pose=pose,
    )


def noted_targets(recording: Recording, notes: list[Note], found: Paths) -> list[tuple[float, float, float]]:
    """Return the different places (x, y, z) [m] that the policy noted as ``target_m``, in the region's frame at that
    time."""
    base = np.array(recording.header.pose_base_in_world)
    turn = matrix_from_quat(base[3:])
    looked = recording["policy/observation_time_s"]
    places: dict[tuple[float, float, float], None] = {}
    for note in notes:
        target = note.content.get("target_m")
        if not _is_place(target) or note.observation_index >= len(looked):
            continue
        period = min(int(np.searchsorted(found.time_s, looked[note.observation_index])), len(found.time_s) - 1)
        place = points_in_region((turn @ np.array(target, float) + base[:3])[None], found.pose[period][None])[0]
        x, y, z = (round(float(value), 4) for value in place)
        places[x, y, z] = None
    return list(places)


def _is_place(value: object) -> bool:
    """Whether a note is a position: a policy can note anything."""
    if not isinstance(value, list) or len(value) != 3:  # pyright: ignore[reportUnknownArgumentType]
        return False
    return all(isinstance(v, int | float) and np.isfinite(v) for v in value)  # pyright: ignore[reportUnknownVariableType]
