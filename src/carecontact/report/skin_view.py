"""A region's skin from above, with the paths of tool and target on it."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError
from carecontact.interface.geometry import matrix_from_quat
from carecontact.recording.notes import Note
from carecontact.recording.schema import Recording
from carecontact.report.moment import Moment, ends_of, region_column, region_poses
from carecontact.report.svg import Drawing, inside
from carecontact.scoring.progress import points_in_region

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
    """Return the different places (x, y, z) [m] noted as ``target_m``, in the region's frame at that time."""
    base = np.array(recording.header.pose_base_in_world)
    turn = matrix_from_quat(base[3:])
    looked = recording["policy/observation_time_s"]
    places: list[tuple[float, float, float]] = []
    for note in notes:
        target = note.content.get("target_m")
        if not _is_place(target) or note.observation_index >= len(looked):
            continue
        period = min(int(np.searchsorted(found.time_s, looked[note.observation_index])), len(found.time_s) - 1)
        place = points_in_region((turn @ np.array(target, float) + base[:3])[None], found.pose[period][None])[0]
        x, y, z = np.round(place, 4).tolist()
        places.append((x, y, z))
    return list(dict.fromkeys(places))


def _is_place(value: object) -> bool:
    """Whether a note is a position: a policy can note anything."""
    if not isinstance(value, list) or len(value) != 3:  # pyright: ignore[reportUnknownArgumentType]
        return False
    return all(isinstance(v, int | float) and np.isfinite(v) for v in value)  # pyright: ignore[reportUnknownVariableType]


# The tool's path over the skin, seen from two sides.
#
# Classes used: ``reached``, ``contact``, ``commanded``, ``pressed``, ``noted``, ``start``, ``peak``, ``scale``,
# ``note``.

WIDTH = 460
FOOT = 24
"""Height of the strip under a view that shows its scale."""
AROUND_M, ABOVE_M, ASIDE_M = 0.05, 0.06, 0.035
"""Beyond the region along it, above the skin and beside it, that a view shows."""
FINENESS = 2
"""Pixels of the skin's picture for one pixel of the drawing."""
DARK, LIGHT = np.array([96, 118, 150.0]), np.array([196, 216, 236.0])
"""BGR of skin that lies along the line of sight, and of skin that faces the viewer."""
DEEPEST_CELL = 0.85
"""Opacity of the cell that felt the most."""


@dataclass(frozen=True, kw_only=True)
class Side:
    name: str
    words: str
    """Which way one looks; ``{ahead}`` is where the region's x axis leads."""
    up: int
    """Axis of the region's frame that goes up in the view; x goes to the right."""
    toward: F64
    """(3,) unit vector to the viewer"""


SIDES = (
    Side(
        name="from outside",
        words="Seen from outside: straight onto the skin of the region, toward the bone. Right is {ahead}.",
        up=1,
        toward=np.array([0.0, 0.0, 1.0]),
    ),
    Side(
        name="from the side",
        words=(
            "Seen from the side: along the skin, a quarter turn from the other view. Up is away from the bone, so that "
            "a tool that presses straight onto the region comes from above. Right is {ahead}."
        ),
        up=2,
        toward=np.array([0.0, -1.0, 0.0]),
    ),
)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The part of a view that is drawn: its lower left corner and its upper right one [m], along and up."""

    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        return WIDTH / (self.high[0] - self.low[0])

    @property
    def height(self) -> float:
        return self.scale * (self.high[1] - self.low[1])

    def px(self, points: F64, up: int) -> F64:
        """(N, 3) -> (N, 2) pixels."""
        x = (points[:, 0] - self.low[0]) * self.scale
        return np.stack([x, self.height - (points[:, up] - self.low[1]) * self.scale], axis=1)

    def shown(self, points: F64, up: int) -> list[tuple[float, float]]:
        """(N, 3) -> the (x, y) [px] of those of them that lie in the view."""
        px = self.px(points, up)
        within = ((px >= 0) & (px <= [WIDTH, self.height])).all(axis=1)
        return [(float(x), float(y)) for x, y in px[within]]


def skin_views(
    recording: Recording, found: Paths, moment: Moment | None, noted: list[tuple[float, float, float]]
) -> list[tuple[str, str]]:
    """Return for each view which way one looks and its drawing; empty without a skin. Raises as ``skin_of``."""
    stored = skin_of(recording, len(recording["scorer/time_s"]) - 1 if moment is None else moment.index)
    if stored is None:
        return []
    skin, faces = stored
    spec = recording.header.spec
    _, ahead = ends_of(spec.protocol.task(spec.task_id).region)
    return [
        (side.words.format(ahead=ahead), _view(recording, side, skin, faces, found, moment, noted)) for side in SIDES
    ]


def _view(
    recording: Recording, side: Side, skin: F64, faces: npt.NDArray[np.integer], found: Paths, moment: Moment | None,
    noted: list[tuple[float, float, float]],
) -> str:  # fmt: skip
    reach = float(recording["scorer/region_size_m"][region_column(recording), 0]) / 2 + AROUND_M
    within = skin[np.abs(skin[:, 0]) < reach]
    low, high = (float(within[:, side.up].min()), float(within[:, side.up].max())) if len(within) else (-0.1, 0.1)
    below, above = (0.01, ABOVE_M) if side.up == 2 else (ASIDE_M, ASIDE_M)
    frame = Frame(low=(-reach, low - below), high=(reach, high + above))
    title = f"Path of the tool over the skin, seen {side.name}"
    drawing = Drawing(width=WIDTH, height=round(frame.height) + FOOT, style="skin", title=title)
    drawing.image(skin_uri(frame, side, skin, faces))
    _draw_cells(drawing, frame, side, recording)
    touching = [found.reached_m[stretch] for stretch in _touching(recording, found)]
    lines = [("commanded", found.commanded_m), ("reached", found.reached_m), *(("contact", line) for line in touching)]
    for style, line in lines:
        for part in inside(frame.px(line, side.up), WIDTH, frame.height):
            drawing.polyline(style, part)
    for x, y in frame.shown(np.array(noted).reshape(-1, 3), side.up):
        drawing.cross("noted", x, y)
    if moment is not None:
        for x, y in frame.shown(moment.centroid_in_region[None], side.up):
            drawing.circle("peak", x, y, 4.5)
    _draw_scale(drawing, frame, recording)
    return drawing.svg()


def _touching(recording: Recording, found: Paths) -> list[slice]:
    """Ranges of consecutive control periods in which any segment bears a force."""
    from carecontact.scoring.contact import runs

    felt = np.any(recording["scorer/normal_force"] > 0, axis=1)
    step = np.clip(np.searchsorted(recording["scorer/time_s"], found.time_s) - 1, 0, None)
    return [slice(start, stop) for start, stop in runs(felt[step]).tolist() if stop - start > 1]


def _draw_cells(drawing: Drawing, frame: Frame, side: Side, recording: Recording) -> None:
    """Patches of skin that face the viewer, the darker the more impulse they felt."""
    cells, press = (recording.arrays.get(f"scorer/cell_{name}") for name in ("in_region", "press_ns"))
    if cells is None or press is None or not press.size:
        return
    felt = press.sum(axis=0, dtype=np.float64)
    size = recording["scorer/region_size_m"][region_column(recording)]
    normal = cells[:, 1:] / np.array([size[1], size[2]]) ** 2
    shown = np.asarray(normal @ side.toward[1:] > 0) & (felt > 0.02 * felt.max())
    radius = 0.5 * 0.0075 * frame.scale
    for index in np.flatnonzero(shown):
        for x, y in frame.shown(cells[index][None].astype(np.float64), side.up):
            drawing.circle("pressed", x, y, radius, opacity=DEEPEST_CELL * float(felt[index] / felt.max()))


def skin_of(recording: Recording, step: int) -> tuple[F64, npt.NDArray[np.integer]] | None:
    """Return the skin, stored at a physics step: vertices (N, 3) [m] in the region's frame, and triangles (M, 3).

    None where the recording has no skin (before this release). Raises RecordingError for one of the wrong shape.
    """
    if "report/skin_in_world" not in recording.arrays or "report/skin_faces" not in recording.arrays:
        return None
    vertices, faces = recording["report/skin_in_world"], recording["report/skin_faces"]
    shapes_fit = vertices.ndim == 2 == faces.ndim and vertices.shape[1] == 3 == faces.shape[1]
    if not shapes_fit or not faces.size or faces.min() < 0 or faces.max() >= len(vertices):
        raise RecordingError(f"{recording.header.spec.trial_id}: report/skin_faces does not fit report/skin_in_world")
    pose = region_poses(recording)[step]
    return points_in_region(vertices.astype(np.float64), np.tile(pose, (len(vertices), 1))), faces


def _draw_scale(drawing: Drawing, frame: Frame, recording: Recording) -> None:
    spec = recording.header.spec
    back, ahead = ends_of(spec.protocol.task(spec.task_id).region)
    y, length = drawing.height - 8, 0.05 * frame.scale
    drawing.path("scale", f"M{drawing.width / 2 - length / 2:.1f} {y:.1f}h{length:.1f}")
    drawing.text("note", drawing.width / 2, y - 5, "50 mm", anchor="middle")
    drawing.text("note", 6, y, f"← {back}")
    drawing.text("note", drawing.width - 6, y, f"{ahead} →", anchor="end")


def skin_uri(frame: Frame, side: Side, skin: F64, faces: npt.NDArray[np.integer]) -> str:
    """Return (N, 3) vertices [m] in the view's frame as a picture: triangles from far to near, shaded by slope."""
    from PIL import Image, ImageDraw

    from carecontact.pictures import png

    corner = skin[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(across, axis=1)
    facing = (across @ side.toward) / np.maximum(size, 1e-12)
    px = (FINENESS * frame.px(skin, side.up))[faces]
    height, width = round(FINENESS * frame.height), FINENESS * WIDTH
    seen = (facing > 0) & (px.max(axis=1) > 0).all(axis=1) & (px.min(axis=1) < [width, height]).all(axis=1)
    order = np.flatnonzero(seen)
    order = order[np.argsort((corner[order] @ side.toward).mean(axis=1), kind="stable")]
    image = Image.new("RGBA", (width, height))
    draw = ImageDraw.Draw(image)
    colour = DARK + facing[:, None] * (LIGHT - DARK)
    for index in order:
        shade = (*colour[index].astype(int).tolist(), 255)
        draw.polygon(np.round(px[index]).ravel().tolist(), fill=shade, outline=shade)
    return "data:image/png;base64," + base64.b64encode(png(np.array(image))).decode()
