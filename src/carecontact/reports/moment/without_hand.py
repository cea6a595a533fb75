"""The contact of a moment, drawn from the stored skin on a side from which the skin round it is seen.

The stored picture is taken from a fixed side of the region. In a push, the robot's hand or the limb itself can stand
between that camera and the contact. Rays decide whether it does: they go from the skin round the contact to the camera.

Classes used: those of ``reports.moment.picture``, and ``tip`` and ``tool``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import robot_of
from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.rays import Triangles
from carecontact.recording.schema import Recording
from carecontact.reports.moment.moment import Moment, region_poses
from carecontact.reports.moment.picture import draw_contact
from carecontact.reports.svg import Drawing
from carecontact.reports.trial.skin_view import SIDES, WIDTH, Frame, skin_of, skin_uri
from carecontact.scoring.region import points_in_region

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
    """Return the drawing; None where the recording has no skin round the contact.

    Args:
        title: text alternative.

    Raises RecordingError for a skin of the wrong shape.
    """
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
    """Share of the triangles round the contact from which a ray reaches the viewer.

    Args:
        way: (R, 3) from each of them to the viewer [m].
    """
    length = np.linalg.norm(way, axis=1)
    toward = way / length[:, None]
    faces = (toward * found.normals).sum(axis=1) > FACING
    free = in_the_way.distances(found.ring + OFF_SKIN_M * toward, toward) > length
    return float((faces & free).mean())


def _view(found: _Round) -> F64:
    """(3, 3) rows right, up and toward the viewer of the view that sees most of the skin round the contact, at a slant
    to it."""
    outward = found.normals.mean(axis=0)
    outward = outward / max(float(np.linalg.norm(outward)), 1e-9)
    skin = Triangles(_near(found))
    level: F64 = np.cross(found.up, [1.0, 0.0, 0.0])
    level /= np.linalg.norm(level)
    ahead: F64 = np.cross(level, found.up)
    best: F64 = np.eye(3)
    most = -np.inf
    for elevation, azimuth in product(np.radians(ELEVATIONS_DEG), np.radians(AZIMUTHS_DEG)):
        toward: F64 = (
            np.cos(elevation) * (np.cos(azimuth) * ahead + np.sin(azimuth) * level) + np.sin(elevation) * found.up
        )
        right: F64 = np.cross(found.up, toward)
        right /= np.linalg.norm(right)
        # Only the person's skin can be in the way: the hand is not drawn.
        share = _share_seen(skin, found, np.tile(toward, (len(found.ring), 1)))
        # Half way between straight onto the skin and along it: the one hides the dent, the other the place.
        merit = share * float(toward @ outward) * float(np.linalg.norm(np.cross(toward, outward)))
        if merit > most:
            best, most = np.stack([right, np.cross(toward, right), toward]), merit
    return best


def _draw_tip(drawing: Drawing, recording: Recording, found: _Round, turn: F64, frame: Frame) -> None:
    """The tool's axis, and the outline of the ellipsoid at its tip where the robot is known; both half transparent."""
    back = found.tcp - TOOL_M * found.hand[:, 2]
    (x0, y0), (x1, y1) = frame.px(np.array([found.tcp, back]) @ turn.T, 1).tolist()
    drawing.path("tool", f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}")
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
