"""The picture of a moment with the robot's hand taken away, and of a trial that missed the person."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import Triangles, matrix_from_quat
from carecontact.interface.robot import robot_of
from carecontact.recording.schema import Recording
from carecontact.report.moment import Moment, draw_contact, region_column, region_poses
from carecontact.report.skin_view import SIDES, WIDTH, Frame, skin_of, skin_uri
from carecontact.report.svg import Drawing, convex_hull, inside
from carecontact.scoring.progress import distance_to_surface, points_in_region

# The contact of a moment, drawn from the stored skin on a side from which the skin round it is seen.
#
# The stored picture is taken from a fixed side of the region. In a push, the robot's hand or the limb itself can stand
# between that camera and the contact. Rays decide whether it does: they go from the skin round the contact to the
# camera.
#
# Classes used: those of ``reports.moment.picture``, and ``tip`` and ``tool``.

F64 = npt.NDArray[np.float64]
HEIGHT = 300
SHOWN_M = 0.17
"""Width of the skin that the drawing shows."""
RING_M = (0.006, 0.030)
"""The skin counts that lies between these distances from the contact; the tip itself covers what is nearer."""
SPOTS = 24
"""Number of places on that skin from which rays go, at most."""
CLEAR = 0.4
"""Least share of that skin which the stored camera must see; below, the contact is drawn as well."""
NEAR_M = 0.12
"""Skin farther from the contact is not taken to hide it."""
FACING = 0.15
"""Least cosine between the skin's normal and the direction to the viewer at which the skin can be made out."""
OFF_SKIN_M = 0.004
"""Rays begin at this distance from the skin, so that they do not meet the triangles where they begin."""
FAR_M = 100.0
"""Distance of a viewer to whom all lines of sight are parallel."""
TOOL_M = 0.06
"""Length of the tool's axis that is drawn, back from its tip."""
AZIMUTHS_DEG, ELEVATIONS_DEG = range(0, 360, 30), (15, 35, 55, -5)
"""Directions from which the drawing may look, round the vertical and above the horizon."""


@dataclass(frozen=True, kw_only=True)
class _Round:
    """The skin round a contact and the robot's hand. All places are in the region's frame [m]."""

    skin: F64
    """(N, 3) vertices of the stored skin."""
    faces: npt.NDArray[np.integer]
    """(M, 3)"""
    ring: F64
    """(R, 3) middles of the triangles round the contact."""
    normals: F64
    """(R, 3) their unit normals."""
    contact: F64
    """(3,)"""
    tcp: F64
    """(3,)"""
    hand: F64
    """(3, 3) columns: the hand's axes."""
    up: F64
    """(3,) upward in the world."""


def is_hidden(recording: Recording, moment: Moment) -> bool:
    """Whether the robot's hand or the person hides the skin round the contact from the stored picture's camera.

    False where the recording does not have the skin or the camera. Raises RecordingError for a skin of the wrong shape.
    """
    camera = recording.arrays.get("report/peak_pose_camera_in_world")
    found = None if camera is None else _round(recording, moment)
    if camera is None or found is None:
        return False
    eye = points_in_region(camera[None, :3].astype(np.float64), region_poses(recording)[moment.index][None])[0]
    robot = recording.header.spec.protocol.scene.robot
    boxes = [_box(found, half_m, behind_m) for half_m, behind_m in robot.hand_boxes_m]
    in_the_way = np.concatenate([_near(found), *boxes])
    return _share_seen(Triangles(in_the_way), found, eye - found.ring) < CLEAR


def drawn_svg(recording: Recording, moment: Moment, *, title: str) -> str | None:
    """None where the recording has no skin round the contact. Raises RecordingError as ``skin_of``."""
    found = _round(recording, moment)
    if found is None:
        return None
    turn = _view(found)
    (x, y, _) = turn @ found.contact
    half = np.array([SHOWN_M, SHOWN_M * HEIGHT / WIDTH]) / 2
    frame = Frame(low=(x - half[0], y - half[1]), high=(x + half[0], y + half[1]))
    drawing = Drawing(width=WIDTH, height=HEIGHT, style="skin moment drawn", title=title)
    drawing.image(skin_uri(frame, SIDES[0], found.skin @ turn.T, found.faces))
    pose = region_poses(recording)[moment.index]

    def project(points: F64) -> F64:
        flat = points.reshape(-1, 3)
        placed = points_in_region(flat, np.tile(pose, (len(flat), 1))) @ turn.T
        return frame.px(placed, 1).reshape(*points.shape[:-1], 2)

    _draw_tip(drawing, recording, found, turn, frame)
    far = moment.centroid_in_world + FAR_M * (matrix_from_quat(pose[3:]) @ turn[2])
    draw_contact(drawing, recording, moment, project, eye=far)
    return drawing.svg()


def _round(recording: Recording, moment: Moment) -> _Round | None:
    """None where the recording has no skin near the contact."""
    stored = skin_of(recording, moment.index)
    if stored is None:
        return None
    skin, faces = stored
    corners = skin[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    apart = np.linalg.norm(middles - moment.centroid_in_region, axis=1)
    near = np.flatnonzero((apart > RING_M[0]) & (apart < RING_M[1]) & (np.linalg.norm(across, axis=1) > 0))
    if not near.size:
        return None
    near = near[np.unique(np.linspace(0, near.size - 1, SPOTS).astype(int))]
    region = region_poses(recording)[moment.index]
    pose = recording["scorer/pose_tcp_in_world"][moment.index].astype(np.float64)
    turn = matrix_from_quat(region[3:]).T
    return _Round(
        skin=skin, faces=faces, ring=middles[near],
        normals=across[near] / np.linalg.norm(across[near], axis=1, keepdims=True), contact=moment.centroid_in_region,
        tcp=points_in_region(pose[None, :3], region[None])[0], hand=turn @ matrix_from_quat(pose[3:]),
        up=turn @ np.array([0.0, 0.0, 1.0]),
    )  # fmt: skip


def _near(found: _Round) -> F64:
    """(m, 3, 3) corners of the skin's triangles that can hide the contact from a viewer."""
    corners = found.skin[found.faces]
    return corners[np.linalg.norm(corners.mean(axis=1) - found.contact, axis=1) < NEAR_M]


def _box(found: _Round, half_m: tuple[float, float, float], behind_m: float) -> F64:
    """(12, 3, 3) corners of the triangles of a box behind the tool centre point, in the hand's axes."""
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    corners = found.tcp + (signs * half_m - [0.0, 0.0, behind_m]) @ found.hand.T
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return corners[[part for a, b, c, d in sides for part in ((a, b, c), (a, c, d))]]


def _share_seen(in_the_way: Triangles, found: _Round, way: F64) -> float:
    """Share of the triangles round the contact from which a ray, (R, 3) ``way`` [m], reaches the viewer."""
    length = np.linalg.norm(way, axis=1)
    toward = way / length[:, None]
    faces = (toward * found.normals).sum(axis=1) > FACING
    free = in_the_way.distances(found.ring + OFF_SKIN_M * toward, toward) > length
    return float((faces & free).mean())


def _view(found: _Round) -> F64:
    """(3, 3) the view that sees most of the skin round the contact, at a slant to it."""
    outward = found.normals.mean(axis=0)
    outward = outward / max(float(np.linalg.norm(outward)), 1e-9)
    skin = Triangles(_near(found))

    def merit(turn: F64) -> float:
        toward = turn[2]
        # Only the person's skin can be in the way: the hand is not drawn.
        share = _share_seen(skin, found, np.tile(toward, (len(found.ring), 1)))
        # Half way between straight onto the skin and along it: the one hides the dent, the other the place.
        return share * float(toward @ outward) * float(np.linalg.norm(np.cross(toward, outward)))

    return max(_views(found.up, AZIMUTHS_DEG, ELEVATIONS_DEG), key=merit)


def _views(up: F64, azimuths_deg: Iterable[int], elevations_deg: Iterable[int]) -> list[F64]:
    """(3, 3) rows right, up and toward the viewer of each view, round the vertical and above the horizon."""
    level: F64 = np.cross(up, [1.0, 0.0, 0.0])
    level /= np.linalg.norm(level)
    ahead: F64 = np.cross(level, up)
    turns: list[F64] = []
    for elevation, azimuth in product(map(radians, elevations_deg), map(radians, azimuths_deg)):
        toward = cos(elevation) * (cos(azimuth) * ahead + sin(azimuth) * level) + sin(elevation) * up
        right: F64 = np.cross(up, toward)
        right /= np.linalg.norm(right)
        turns.append(np.stack([right, np.cross(toward, right), toward]))
    return turns


def _draw_tip(drawing: Drawing, recording: Recording, found: _Round, turn: F64, frame: Frame) -> None:
    """The tool's axis, and the outline of the ellipsoid at its tip where the robot is known; both half transparent."""
    back = found.tcp - TOOL_M * found.hand[:, 2]
    drawing.line("tool", frame.px(np.array([found.tcp, back]) @ turn.T, 1))
    robot = robot_of(recording.header.embodiment)
    if robot is None:
        return
    tip = robot.tip
    middle = found.tcp - tip.half_m[2] * found.hand[:, 2]
    # The outline of a unit sphere that a matrix maps onto a plane is an ellipse: the image of a circle by U S.
    u, s, _ = np.linalg.svd((turn @ found.hand @ np.diag(tip.half_m))[:2])
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    outline = (u * s) @ np.array([np.cos(angles), np.sin(angles)])
    placed = np.column_stack([outline.T + (turn @ middle)[:2], np.zeros(len(angles))])
    drawing.polygon("tip", [(float(x), float(y)) for x, y in frame.px(placed, 1)])


# A picture of the place at which a tool without contact came nearest to the region, drawn from the stored skin.
#
# The picture that a trial stores at its end is taken near the tool, and does not show a region that is far from it.
#
# Classes used: ``outline``, ``reached``, ``tool``, ``gap``, ``note``.

MISSED_TOOL_M = 0.10
"""Length of the tool's axis that is drawn, back from its tip."""
ROOM_M = 0.04
"""Least space round what the picture has to show."""
MISSED_AZIMUTHS_DEG, MISSED_ELEVATIONS_DEG = range(0, 360, 15), (15, 35, 55)
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
    """None where the recording has no skin or no cells of the region. Raises RecordingError as ``skin_of``."""
    stored = skin_of(recording, len(recording["scorer/time_s"]) - 1)
    cells = recording.arrays.get("scorer/cell_in_region")
    if stored is None or cells is None or len(cells) < 3:
        return None
    skin, faces = stored
    region = cells.astype(np.float64)
    nearest = region[np.linalg.norm(region - miss.tip, axis=1).argmin()]
    turn = _view_of_miss(region, recording, miss, nearest)
    path = points_in_region(recording["scorer/pose_tcp_in_world"][:, :3].astype(np.float64), region_poses(recording))
    tool = np.array([miss.tip, miss.tip + MISSED_TOOL_M * miss.tool])
    frame = _frame(np.concatenate([region, tool]) @ turn.T)
    drawing = Drawing(width=WIDTH, height=round(frame.height), style="skin miss", title=title)
    drawing.image(skin_uri(frame, SIDES[0], skin @ turn.T, faces))
    drawing.polygon("outline", convex_hull(frame.px(region @ turn.T, 1)))
    for part in inside(frame.px(path @ turn.T, 1), WIDTH, frame.height):
        drawing.polyline("reached", part)
    drawing.line("tool", frame.px(tool @ turn.T, 1))
    gap = frame.px(np.array([miss.tip, nearest]) @ turn.T, 1)
    drawing.line("gap", gap)
    x, y = gap.mean(axis=0).tolist()
    anchor, aside = ("end", -8) if x > WIDTH - 90 else ("start", 8)
    drawing.text("note", x + aside, y - 6, f"{1000 * miss.away_m:.0f} mm", anchor=anchor)
    return drawing.svg()


def _view_of_miss(region: F64, recording: Recording, miss: Miss, nearest: F64) -> F64:
    """(3, 3) the view that shows the gap and the region's skin best."""
    gap = nearest - miss.tip
    size = recording["scorer/region_size_m"][region_column(recording)]
    normals = np.c_[np.zeros(len(region)), region[:, 1:] / np.array([size[1], size[2]]) ** 2]
    outward = (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)).mean(axis=0)

    def merit(turn: F64) -> float:
        seen = float(np.linalg.norm(turn[:2] @ gap)) / max(float(np.linalg.norm(gap)), 1e-9)
        return seen + float(turn[2] @ outward)

    return max(_views(miss.up, MISSED_AZIMUTHS_DEG, MISSED_ELEVATIONS_DEG), key=merit)


def _frame(shown: F64) -> Frame:
    """Round all places that the picture has to show, with the sides of WIDTH and HEIGHT."""
    low, high = shown[:, :2].min(axis=0) - ROOM_M, shown[:, :2].max(axis=0) + ROOM_M
    middle = (low + high) / 2
    half = max(high[0] - low[0], (high[1] - low[1]) * WIDTH / HEIGHT) / 2 * np.array([1.0, HEIGHT / WIDTH])
    return Frame(low=tuple((middle - half).tolist()), high=tuple((middle + half).tolist()))
