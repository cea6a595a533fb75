"""Words on the place of a contact: along and across the region, inside its outline or not, at the tool's tip or not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import robot_of
from carecontact.contract.geometry import matrix_from_quat
from carecontact.recording.schema import Recording
from carecontact.regions import REGIONS
from carecontact.reports.moment.moment import Moment, ends_of, region_column
from carecontact.reports.text import percent

F64 = npt.NDArray[np.float64]
BESIDE_TIP_M = 0.01
"""A force that acts farther from the tip's ellipsoid than this does not come from the tip; the skin bulges round it."""
LITTLE_FELT = 0.5
"""Share of the force below which the page says how little of it the region's cells felt."""


def place_text(recording: Recording, moment: Moment) -> str:
    """Return where on the region the contact was, from its middle; for another segment, its name alone."""
    spec = recording.header.spec
    region = spec.protocol.task(spec.task_id).region
    name = moment.segment.replace("_", " ")
    if moment.segment != REGIONS[region].segment:
        return f"the {name}, not the named region"
    along, across = (round(1000 * float(place)) for place in moment.centroid_in_region[:2])
    back, ahead = ends_of(region)
    where = [f"{abs(along)} mm {ahead if along > 0 else back}"] if along else []
    where += [f"{abs(across)} mm across"] if across else []
    middle = f"{' and '.join(where)} from the middle" if where else "in the middle"
    length = 1000 * float(recording["scorer/region_size_m"][region_column(recording), 0])
    return f"the {name}, {middle} of the region, which is {length:.0f} mm long{_outline_text(recording, moment)}"


def place_notes(recording: Recording, moment: Moment) -> list[str]:
    """Return sentences on a contact that is not what a reader expects: away from the tool's tip, or hardly on the
    region's cells. Empty for an ordinary one."""
    notes: list[str] = []
    away_m = _away_from_tip(recording, moment)
    if away_m is not None:
        notes.append(
            f"The force acts {1000 * away_m:.0f} mm from the tip of the tool: another part of the tool or of the robot "
            "presses, or several parts do."
        )
    felt = _felt_by_cells(recording, moment)
    if felt is not None and felt < LITTLE_FELT:
        notes.append(f"The cells inside the region's outline felt {percent(felt)} of this force.")
    return notes


def _outline_text(recording: Recording, moment: Moment) -> str:
    """Whether the contact lay inside the outline of the region's cells; empty for a recording without cells.

    Cells go round a limb, so that both are laid flat: x along the region, y the angle about its axis times the
    outward radius.
    """
    import cv2

    cells = recording.arrays.get("scorer/cell_in_region")
    if cells is None or len(cells) < 3:
        return ""
    radius = float(recording["scorer/region_size_m"][region_column(recording), 2])
    hull = cv2.convexHull(_flat(cells.astype(np.float64), radius).astype(np.float32))
    (place,) = _flat(moment.centroid_in_region[None], radius).tolist()
    if cv2.pointPolygonTest(hull, (place[0], place[1]), measureDist=False) >= 0:
        return ", inside the region's outline"
    nearest_m = float(np.linalg.norm(cells - moment.centroid_in_region, axis=1).min())
    return f", outside the region's outline: {1000 * nearest_m:.0f} mm from the nearest of its cells"


def _flat(places: F64, radius: float) -> F64:
    """(N, 3) -> (N, 2) [m]"""
    return np.stack([places[:, 0], radius * np.arctan2(places[:, 1], places[:, 2])], axis=1)


def _away_from_tip(recording: Recording, moment: Moment) -> float | None:
    """Distance of the contact from the tool's tip [m]; None where the tip presses, and for a robot that this release
    does not have."""
    robot = robot_of(recording.header.embodiment)
    if robot is None:
        return None
    tip = robot.tip
    pose = recording["scorer/pose_tcp_in_world"][moment.index].astype(np.float64)
    offset = moment.centroid_in_world - pose[:3]
    from_middle = matrix_from_quat(pose[None, 3:])[0].T @ offset + [0.0, 0.0, tip.half_m[2]]
    outside = np.linalg.norm(from_middle / (np.array(tip.half_m) + BESIDE_TIP_M)) > 1.0
    return float(np.linalg.norm(offset)) if outside else None


def _felt_by_cells(recording: Recording, moment: Moment) -> float | None:
    """Share of the segment's normal force that the cells felt in the control period of the moment; None where another
    segment was pressed, or without cells."""
    press, ends = recording.arrays.get("scorer/cell_press_ns"), recording["scorer/period_time_s"]
    if press is None or not ends.size or moment.depth_m is None:
        return None
    period = min(int(np.searchsorted(ends, moment.time_s)), len(ends) - 1)
    begin = float(ends[period - 1]) if period else 0.0
    times, dt_s = recording["scorer/time_s"], recording.header.spec.protocol.physics.dt_s
    within = (times > begin - dt_s / 2) & (times < float(ends[period]) - dt_s / 2)
    column = recording.header.segments.index(moment.segment)
    whole = float(recording["scorer/normal_force"][within, column].sum(dtype=np.float64)) * dt_s
    return min(float(press[period].sum(dtype=np.float64)) / whole, 1.0) if whole > 0 else None
