"""Where, how hard and how deep the robot pressed at peak force, drawn into the picture of that moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat, pixels, pose_matrix
from carecontact.interface.regions import REGIONS, LimbSight
from carecontact.interface.robot import robot_of
from carecontact.recording.schema import Recording
from carecontact.report.svg import Drawing, convex_hull, in_convex, jpeg_data_uri
from carecontact.report.words import percent
from carecontact.scoring.progress import points_in_region, surface_normal

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
    time_s, periods = float(recording["scorer/time_s"][index]), recording["scorer/period_time_s"]
    depth_m = deepest = None
    if column == target and periods.size:
        depths = recording["scorer/indentation_m"][:, region_column(recording)]
        depth_m = float(depths[min(int(np.searchsorted(periods, time_s)), len(periods) - 1)])
        deepest = float(depths.max()), float(periods[depths.argmax()])
    return Moment(
        index=int(index),
        time_s=time_s,
        segment=recording.header.segments[column],
        force_in_world=force[index, column].astype(np.float64),
        centroid_in_world=centroid,
        centroid_in_region=inside[0],
        outward_in_world=turn @ outward,
        depth_m=depth_m,
        deepest=deepest,
    )


def ends_of(region: str) -> tuple[str, str]:
    """Return words for the directions against and along the region's x axis."""
    is_limb = isinstance(REGIONS[region].sight, LimbSight)
    return ("toward the trunk", "toward the hand") if is_limb else ("toward the feet", "toward the head")


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
    """Return sentences on a contact that is away from the tool's tip, or hardly on the region's cells."""
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
    """Whether the contact lay inside the outline of the region's cells, laid flat; empty for a recording without
    cells."""
    cells = recording.arrays.get("scorer/cell_in_region")
    if cells is None or len(cells) < 3:
        return ""
    radius = float(recording["scorer/region_size_m"][region_column(recording), 2])
    hull = convex_hull(_flat(cells.astype(np.float64), radius))
    (place,) = _flat(moment.centroid_in_region[None], radius).tolist()
    if in_convex((place[0], place[1]), hull):
        return ", inside the region's outline"
    nearest_m = float(np.linalg.norm(cells - moment.centroid_in_region, axis=1).min())
    return f", outside the region's outline: {1000 * nearest_m:.0f} mm from the nearest of its cells"


def _flat(places: F64, radius: float) -> F64:
    """(N, 3) -> (N, 2) [m]"""
    return np.stack([places[:, 0], radius * np.arctan2(places[:, 1], places[:, 2])], axis=1)


def _away_from_tip(recording: Recording, moment: Moment) -> float | None:
    """[m]; None where the tip presses, and for a robot that this release does not have."""
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
    """Share of the segment's normal force in the control period; None where another was pressed, or without cells."""
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


# The stored picture at peak force, cropped to the contact, with force, indentation and region drawn in.
#
# Classes used: ``arrow``, ``head``, ``outline``, ``depth``, ``halo``, ``note``.

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
    """Draw a moment into the stored picture; None without one. Raises RecordingError for an image of another shape."""
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
    """``eye``: (3,) place of the viewer in the world [m]."""
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
    """Return the outline [px] of the region's cells that face the viewer at a step; empty with fewer than three.

    Cells go round a limb: an outline with those of its far side would enclose places that are not on the region.
    """
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
    return convex_hull(project(facing))


def _draw_arrow(drawing: Drawing, start: F64, tip: F64, text: str) -> None:
    along = (tip - start) / max(float(np.linalg.norm(tip - start)), 1e-9)
    across = np.array([-along[1], along[0]])
    neck = tip - 11 * along
    head = np.array([tip, neck + 5.5 * across, neck - 5.5 * across]).tolist()
    for style in (" halo", ""):
        drawing.line(f"arrow{style}", [start, neck])
        drawing.polygon(f"head{style}", head)
    # The words on the depth are to the upper left of the contact: those on the force stand behind an arrow that stands,
    # and above one that lies, or below it where it comes from the left.
    lies, aside = abs(along[0]) > SIDEWAYS, [0, 20 if along[0] > 0 else -12]
    x, y = ((start + tip) / 2 + aside if lies else start - 8 * along).tolist()
    drawing.text("note", float(np.clip(x, 60, drawing.width - 60)), max(y, 16), text, anchor="middle")


def _draw_end_on(drawing: Drawing, tip: F64, text: str) -> None:
    x, y = tip.tolist()
    for style in (" halo", ""):
        drawing.circle(f"arrow{style}", x, y, 8)
        drawing.cross(f"arrow{style}", x, y)
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
