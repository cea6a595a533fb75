"""A picture of the place at which a tool that touched nobody came nearest to the region, drawn from the stored skin.

The picture that a trial stores at its end is taken near the tool, and does not show a region that is far from it.

Classes used: ``outline``, ``reached``, ``tool``, ``gap``, ``note``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import cos, radians, sin

import cv2
import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat
from carecontact.recording.schema import Recording
from carecontact.reports.moment.moment import region_column, region_poses
from carecontact.reports.svg import Drawing
from carecontact.reports.trial.clip import inside
from carecontact.reports.trial.skin_view import SIDES, WIDTH, Frame, skin_of, skin_uri
from carecontact.scoring.region import distance_to_surface, points_in_region

F64 = npt.NDArray[np.float64]
HEIGHT = 300
TOOL_M = 0.10
"""Length of the tool's axis that is drawn, back from its tip."""
ROOM_M = 0.04
"""Least space round what the picture has to show."""
AZIMUTHS_DEG, ELEVATIONS_DEG = range(0, 360, 15), (15, 35, 55)
"""Directions from which the picture may look, round the vertical and above the horizon."""


@dataclass(frozen=True, kw_only=True)
class Miss:
    """The moment at which the tip of the tool was nearest to the region. Places are in the region's frame [m]."""

    step: int
    time_s: float
    away_m: float
    """Distance of the tip from the region's surface."""
    tip: F64
    """(3,)"""
    tool: F64
    """(3,) unit vector from the tip back along the tool."""
    up: F64
    """(3,) unit vector upward in the world."""


def nearest_miss(recording: Recording) -> Miss | None:
    """Return the moment at which the tool was nearest; None for a trial without a physics step."""
    pose = recording["scorer/pose_tcp_in_world"].astype(np.float64)
    if not len(pose):
        return None
    regions = region_poses(recording)
    size = recording["scorer/region_size_m"][region_column(recording)]
    tips = points_in_region(pose[:, :3], regions)
    away = distance_to_surface(tips, size)
    step = int(away.argmin())
    region, tool = (matrix_from_quat(quat[None])[0] for quat in (regions[step, 3:], pose[step, 3:]))
    return Miss(
        step=step, time_s=float(recording["scorer/time_s"][step]), away_m=max(float(away[step]), 0.0), tip=tips[step],
        tool=-region.T @ tool[:, 2], up=region.T @ [0.0, 0.0, 1.0],
    )  # fmt: skip


def miss_svg(recording: Recording, miss: Miss, *, title: str) -> str | None:
    """Return the picture; None where the recording has no skin or no cells of the region.

    Args:
        title: text alternative.

    Raises RecordingError for a skin of the wrong shape.
    """
    stored, cells = (
        skin_of(recording, len(recording["scorer/time_s"]) - 1),
        recording.arrays.get("scorer/cell_in_region"),
    )
    if stored is None or cells is None or len(cells) < 3:
        return None
    skin, faces = stored
    region = cells.astype(np.float64)
    nearest = region[np.linalg.norm(region - miss.tip, axis=1).argmin()]
    turn = _view(region, recording, miss, nearest)
    path = points_in_region(recording["scorer/pose_tcp_in_world"][:, :3].astype(np.float64), region_poses(recording))
    tool = np.array([miss.tip, miss.tip + TOOL_M * miss.tool])
    frame = _frame(np.concatenate([region, tool]) @ turn.T)
    drawing = Drawing(width=WIDTH, height=round(frame.height), style="skin miss", title=title)
    drawing.image(skin_uri(frame, SIDES[0], skin @ turn.T, faces))
    hull = cv2.convexHull(frame.px(region @ turn.T, 1).astype(np.float32)).reshape(-1, 2)
    drawing.polygon("outline", [(float(x), float(y)) for x, y in hull])
    for part in inside(frame.px(path @ turn.T, 1), WIDTH, frame.height):
        drawing.polyline("reached", part)
    (x0, y0), (x1, y1) = frame.px(tool @ turn.T, 1).tolist()
    drawing.path("tool", f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}")
    (x2, y2), *_ = frame.px(nearest[None] @ turn.T, 1).tolist()
    drawing.path("gap", f"M{x0:.1f} {y0:.1f}L{x2:.1f} {y2:.1f}")
    anchor = "end" if (x0 + x2) / 2 > WIDTH - 90 else "start"
    aside = -8 if anchor == "end" else 8
    drawing.text("note", (x0 + x2) / 2 + aside, (y0 + y2) / 2 - 6, f"{1000 * miss.away_m:.0f} mm", anchor=anchor)
    return drawing.svg()


def _view(region: F64, recording: Recording, miss: Miss, nearest: F64) -> F64:
    """(3, 3) rows right, up and toward the viewer of the view that shows the gap and the region's skin best."""
    gap = nearest - miss.tip
    size = recording["scorer/region_size_m"][region_column(recording)]
    normals = np.c_[np.zeros(len(region)), region[:, 1:] / np.array([size[1], size[2]]) ** 2]
    outward = (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)).mean(axis=0)
    level = np.cross(miss.up, [1.0, 0.0, 0.0])
    level /= np.linalg.norm(level)
    ahead = np.cross(level, miss.up)
    best: F64 = np.eye(3)
    most = -np.inf
    for azimuth, elevation in product(map(radians, AZIMUTHS_DEG), map(radians, ELEVATIONS_DEG)):
        flat = cos(azimuth) * ahead + sin(azimuth) * level
        toward = cos(elevation) * flat + sin(elevation) * miss.up
        right = np.cross(miss.up, toward)
        right /= np.linalg.norm(right)
        turn: F64 = np.array([right, np.cross(toward, right), toward])
        merit = float(np.linalg.norm(turn[:2] @ gap)) / max(float(np.linalg.norm(gap)), 1e-9) + float(toward @ outward)
        if merit > most:
            best, most = turn, merit
    return best


def _frame(shown: F64) -> Frame:
    """Round all places that the picture has to show, with the sides of WIDTH and HEIGHT."""
    low, high = shown[:, :2].min(axis=0) - ROOM_M, shown[:, :2].max(axis=0) + ROOM_M
    middle = (low + high) / 2
    half = max(high[0] - low[0], (high[1] - low[1]) * WIDTH / HEIGHT) / 2 * np.array([1.0, HEIGHT / WIDTH])
    return Frame(low=tuple((middle - half).tolist()), high=tuple((middle + half).tolist()))
