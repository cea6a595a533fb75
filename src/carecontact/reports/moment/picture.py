"""The stored picture at peak force, cropped to the contact, with force, indentation and region drawn in.

Classes used: ``arrow``, ``head``, ``outline``, ``depth``, ``halo``, ``note``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import pixels, pose_matrix
from carecontact.recording.schema import Recording
from carecontact.reports.frames import jpeg_data_uri
from carecontact.reports.moment.moment import Moment, region_column, region_poses
from carecontact.reports.svg import Drawing
from carecontact.scoring.region import surface_normal

F64 = npt.NDArray[np.float64]
Project = Callable[[F64], F64]
"""(..., 3) points in the world [m] -> (..., 2) pixels."""
WIDTH, HEIGHT = 400, 260
"""Size of the crop [px]: 0.2 m of the skin."""
EARLIER_WIDTH, EARLIER_HEIGHT = 320, 208
"""Size of the crop [px] where the recording does not say what its camera saw; the tool's tip is then in the middle."""
ARROW_M_PER_N, ARROW_M = 0.0022, (0.025, 0.075)
"""Length of the arrow for a force, and its least and largest."""
SIDEWAYS = 0.7
"""Least cosine with the horizontal at which an arrow counts as lying rather than standing."""
FORESHORTENED_PX = 20
"""An arrow that looks shorter points along the line of sight, and is drawn from behind: a circle with a cross."""


def peak_svg(recording: Recording, moment: Moment | None, *, title: str) -> str | None:
    """Return the picture; None if the trial stored none. Raises RecordingError for an image of another shape.

    Args:
        moment: what is drawn in; None: nothing.
        title: text alternative.
    """
    if "report/peak_rgb" not in recording.arrays:
        return None
    image = recording["report/peak_rgb"]
    height, width = image.shape[:2] if image.ndim == 3 else (1, 1)
    camera = _camera(recording, width, height)
    wide, high = (EARLIER_WIDTH, EARLIER_HEIGHT) if camera is None else (WIDTH, HEIGHT)
    wide, high = min(wide, width), min(high, height)
    u, v = (width / 2, height / 2) if camera is None or moment is None else camera(moment.centroid_in_world).tolist()
    left, top = int(np.clip(u - wide / 2, 0, width - wide)), int(np.clip(v - 0.55 * high, 0, height - high))
    drawing = Drawing(width=wide, height=high, style="moment", title=title)
    drawing.image(jpeg_data_uri(image[top : top + high, left : left + wide] if image.ndim == 3 else image))
    if camera is not None and moment is not None:
        found = camera
        eye = recording["report/peak_pose_camera_in_world"][:3].astype(np.float64)
        draw_contact(drawing, recording, moment, lambda points: found(points) - [left, top], eye=eye)
    return drawing.svg()


def _camera(recording: Recording, width: int, height: int) -> Project | None:
    """None where the recording does not say what its camera saw."""
    pose = recording.arrays.get("report/peak_pose_camera_in_world")
    focal = recording.arrays.get("report/peak_focal_px")
    if pose is None or focal is None:
        return None
    intrinsics = np.array([[focal[0], 0, width / 2], [0, focal[0], height / 2], [0, 0, 1.0]])
    placed = pose_matrix(pose[:3], pose[3:])
    return lambda points: pixels(points, intrinsics, placed)


def draw_contact(drawing: Drawing, recording: Recording, moment: Moment, project: Project, *, eye: F64) -> None:
    """Draw the outline of the region's cells, the force and the indentation of a moment where a view shows them.

    Args:
        eye: (3,) place of the viewer in the world [m].
    """
    outline = region_outline(recording, moment.index, project, eye)
    if len(outline) > 2:
        drawing.polygon("outline halo", outline)
        drawing.polygon("outline", outline)
    tip = moment.centroid_in_world
    force = moment.force_in_world
    length = float(np.clip(ARROW_M_PER_N * moment.force_n, *ARROW_M))
    start = tip - length * force / moment.force_n
    from_px, to_px, text = project(start), project(tip), f"{moment.force_n:.1f} N"
    if np.linalg.norm(to_px - from_px) < FORESHORTENED_PX:
        _draw_end_on(drawing, to_px, text)
    else:
        _draw_arrow(drawing, from_px, to_px, text)
    if moment.depth_m is not None and moment.depth_m > 0:
        _draw_depth(drawing, project(tip), project(tip + moment.depth_m * moment.outward_in_world), moment.depth_m)


def region_outline(recording: Recording, step: int, project: Project, eye: F64) -> list[tuple[float, float]]:
    """Return the outline, in pixels, of those of the region's declared cells that face the viewer, as they lay at a
    physics step; empty where there are fewer than three. Cells go round a limb, and an outline with those of its far
    side would enclose places that are not on the region.
    """
    import cv2

    cells = recording.arrays.get("scorer/cell_in_region")
    if cells is None or len(cells) < 3:
        return []
    pose = region_poses(recording)[step]
    placed = pose_matrix(pose[:3], pose[3:])
    places = cells.astype(np.float64) @ placed[:3, :3].T + placed[:3, 3]
    size = recording["scorer/region_size_m"][region_column(recording)]
    outward = surface_normal(cells.astype(np.float64), size) @ placed[:3, :3].T
    facing = places[(outward * (eye - places)).sum(axis=1) > 0]
    if len(facing) < 3:
        return []
    seen = project(facing)
    hull = cv2.convexHull(seen.astype(np.float32)).reshape(-1, 2)
    return [(float(x), float(y)) for x, y in hull]


def _draw_arrow(drawing: Drawing, start: F64, tip: F64, text: str) -> None:
    along = (tip - start) / max(float(np.linalg.norm(tip - start)), 1e-9)
    across = np.array([-along[1], along[0]])
    neck = tip - 11 * along
    shaft = f"M{start[0]:.1f} {start[1]:.1f}L{neck[0]:.1f} {neck[1]:.1f}"
    head = [tip, neck + 5.5 * across, neck - 5.5 * across]
    drawing.path("arrow halo", shaft)
    drawing.polygon("head halo", [(float(x), float(y)) for x, y in head])
    drawing.path("arrow", shaft)
    drawing.polygon("head", [(float(x), float(y)) for x, y in head])
    # The words on the depth are to the upper left of the contact: those on the force stand behind an arrow that stands,
    # and above one that lies, or below it where it comes from the left.
    lies, aside = abs(along[0]) > SIDEWAYS, [0, 20 if along[0] > 0 else -12]
    x, y = ((start + tip) / 2 + aside if lies else start - 8 * along).tolist()
    drawing.text("note", float(np.clip(x, 60, drawing.width - 60)), max(y, 16), text, anchor="middle")


def _draw_end_on(drawing: Drawing, tip: F64, text: str) -> None:
    x, y = tip.tolist()
    cross = f"M{x - 5:.1f} {y - 5:.1f}l10 10m0 -10l-10 10"
    for style in (" halo", ""):
        drawing.circle(f"arrow{style}", x, y, 8)
        drawing.path(f"arrow{style}", cross)
    drawing.text("note", x + 15, y - 10, text)


def _draw_depth(drawing: Drawing, bottom: F64, top: F64, depth_m: float) -> None:
    """A bracket as long as the indentation, from the contact to where the skin was, beside the contact."""
    beside = np.array([-46.0, 0.0])
    (x0, y0), (x1, y1) = (bottom + beside).tolist(), (top + beside).tolist()
    bracket = f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}M{x0 - 5:.1f} {y0:.1f}h10M{x1 - 5:.1f} {y1:.1f}h10"
    if abs(y1 - y0) > abs(x1 - x0):
        drawing.path("depth halo", bracket)
        drawing.path("depth", bracket)
    drawing.text("note", x0 - 9, (y0 + y1) / 2 + 4, f"{1000 * depth_m:.1f} mm deep", anchor="end")
