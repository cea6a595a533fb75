"""Sample a soft region's shell from the body's own surface, in the mesh frame of the bind pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.regions import Tube
from carecontact.world.human.body import Array, Body
from carecontact.world.human.surface_mesh import (
    GROWTH,
    Triangles,
    bridged,
    distance_outside,
    graded,
    graded_from_middle,
    normals_and_areas,
    smooth_field,
    zip_rows,
)

SHELL_HALF_DEG = 150.0
FINE_HALF_LENGTH_M, FINE_HALF_ROUND_DEG = 0.085, 60.0
"""Limb patch from above: scrub strokes of +-60 mm plus two tool radii, and as far round as it comes from above."""
SIDE_HALF_LENGTH_M, SIDE_HALF_ROUND_DEG = 0.035, 100.0
"""Patch at mid-length of a limb that is pushed sideways."""
BELLY_WIDTH_SHARE = 0.82
"""Of the narrowest section's half breadth: further out the trunk's side begins, which no ray from behind reaches."""
BELLY_FINE_HALF_WIDTH_M, BELLY_FINE_MARGIN_M = 0.080, 0.03
"""The fine patch is this wide at most, and this far from the shell's border."""
CELL_LENGTH_M, CELL_ROUND_M, BELLY_CELL_M = 0.040, 0.012, 0.032
"""Vertices of one cell glide over the bone together; round a limb the cells are narrow, as their normals differ."""
LIMB_LEAN, BELLY_LEAN = 0.25, 0.5
"""How far a vertex's direction leans from its cell's normal (0) to its own (1). With 0, vertices on either side of a
cell's border run together under a deep press, and peaks vary with the place: on the forearm 8 mm deep by 4.5 %
(coefficient of variation over 60 places) with cells 16 mm wide, 2.9 % with 12 mm, 2.4 % with these and the lean. The
more it leans, the more of a press goes past the springs into the bone, as its direction and its cell's tangents are
then not at right angles: at a belly cell's corners 1.8 %; with 0.5 on a limb of 16 mm cells 1.8 %, with 0.25 and 12 mm
0.4 %."""
LIMB_SAMPLES, BELLY_SAMPLES = (41, 61), 41
"""Rays along and round a limb, and each way over the belly."""
SMOOTHING_M = 0.012
"""Standard deviation of the smoothing of the sampled surface: the body's own faces are 20 mm wide, and their ridges
made the force of a press vary by 9-16 % from place to place."""
NAVEL_BALL_M = 0.20
"""A ball of this radius rolled over the belly does not enter the navel, and the shell spans it as the ball does: the
skin in a navel is a fold that bears nothing, and a tool over one met up to 30 % more force, on its rim. The belly of
man-adult, which the laws are fitted on, is lifted by 2.4 mm at most and 0.2 mm in the mean."""
ROW_RATIO = np.sqrt(3) / 2
"""Rows of a triangular lattice stand this much closer than the points in a row."""


@dataclass(frozen=True, kw_only=True)
class Shell:
    """Vertices in rows across the region's axis, triangulated; cells of vertices that glide together."""

    vertices: Array
    """(N, 3) mesh frame"""
    normals: Array
    """(N, 3) outward unit"""
    triangles: npt.NDArray[np.int64]
    """(M, 3) wound outward"""
    pinned: npt.NDArray[np.bool_]
    """(N,) fixed to the bone: border ring and underside"""
    fine: npt.NDArray[np.bool_]
    """(N,) on the patch that the tool reaches"""
    area: Array
    """(N,) share of the surface [m^2]"""
    cell: npt.NDArray[np.int64]
    """(N,) number of the cell; -1 where pinned"""
    cell_frames: Array
    """(C, 3, 3) columns: tangent along the region, tangent across, outward normal"""
    inward: Array
    """(N, 3) unit, the direction that a vertex's anchor gives way in"""
    axis_points: Array
    """(N, 3) point of the region's axis (belly: of its back plane) inward of each vertex"""
    grid: Array
    """(N, 2) place along the axis from the shell's start [m], and across: angle round a limb [rad], on the belly [m]"""
    frame_origin: Array
    frame: Array
    """(3, 3) columns x (along), y, z (outward at the middle): the region frame in the mesh frame"""
    length_m: float
    radius_m: float
    axis_depth_m: float
    """Distance of the axis under the surface at the middle."""


def limb_shell(body: Body, segment: str, tube: Tube, outward: Array, tissue: Tissue) -> Shell:
    """A tube around a limb, fine where the tool reaches it, pinned at the ends and below.

    Args:
        outward: (3,) direction in the mesh frame that faces up in the lying pose.
    """
    start, along = body.joint_centre[segment], body.axis_vector(segment)
    length = float(np.linalg.norm(along))
    x = along / length
    z = outward - (outward @ x) * x
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    low, high = np.array(tube.span) * length
    faces = body.vertices[body.faces]
    triangles = faces[np.abs((faces.mean(1) - (start + along / 2)) @ x) < length / 2 + 0.03]
    middle = triangles.mean(1) - start
    triangles = triangles[np.linalg.norm(middle - np.outer(middle @ x, x), axis=1) < 0.12]

    half_length = min(FINE_HALF_LENGTH_M, (high - low) / 2 - 0.01)
    fine, coarse = tissue.spacing_m, tissue.coarse_spacing_m

    def away(t: Array, theta: Array, radius: float) -> Array:
        """Distance outside the fine patch over the surface [m]."""
        along = t - (low + high) / 2

        def outside(half_length: float, half_deg: float) -> Array:
            round_ = distance_outside(theta, np.radians(half_deg)) * radius
            return np.hypot(distance_outside(along, half_length), round_)

        top = outside(half_length, FINE_HALF_ROUND_DEG)
        return np.minimum(top, outside(SIDE_HALF_LENGTH_M, SIDE_HALF_ROUND_DEG)) if tube.pushed_from_side else top

    def spacing(distance: Array) -> Array:
        return np.clip(fine + GROWTH * distance, None, coarse)

    t = graded(low, high, lambda u: ROW_RATIO * spacing(away(u, np.zeros(len(u)), 1.0)))
    # The joint line runs off centre: measure round the sections' own centres.
    sections = np.linspace(low, high, LIMB_SAMPLES[0])
    surface = Triangles(triangles)
    line = _centre_line(surface, start, x, y, z, sections)
    turns = np.linspace(-np.pi, np.pi, LIMB_SAMPLES[1])
    directions = _directions(y, z, turns)
    measured = np.array([surface.first_hits(centre, directions) for centre in line(sections)])
    radius = float(np.median(measured[len(sections) // 2]))
    radius_at = smooth_field(
        sections, turns, measured, sigma=(SMOOTHING_M / np.ptp(sections), SMOOTHING_M / (2 * np.pi * radius)), wrap=True
    )
    half = np.radians(SHELL_HALF_DEG)
    rows, angles, radii = [], [], []
    for i, (at, centre) in enumerate(zip(t, line(t), strict=True)):

        def step(theta: Array, at=at) -> Array:
            distance = radius_at(at, theta)
            return spacing(away(at, theta, float(np.median(distance)))) / distance

        theta = graded_from_middle(half, step, half_step=bool(i % 2))
        radii.append(radius_at(at, theta))
        rows.append(centre + radii[-1][:, None] * _directions(y, z, theta))
        angles.append(theta)
    grid = np.stack([np.repeat(t, [len(a) for a in angles]), np.concatenate(angles)], 1)
    ends = (grid[:, 0] == t[0]) | (grid[:, 0] == t[-1])
    pinned = ends | (np.abs(grid[:, 1]) > np.radians(tube.pinned_beyond_deg))
    centre = line(np.array([length / 2]))[0]
    depth = float(radius_at(length / 2, np.zeros(1))[0])
    return _finish(
        rows, grid - [low, 0.0], pinned=pinned, fine=away(grid[:, 0], grid[:, 1], radius) <= 1e-9,
        cell_size=(_cell(tissue, CELL_LENGTH_M), _cell(tissue, CELL_ROUND_M)), across_m=np.concatenate(radii),
        lean=LIMB_LEAN,
        axis_points=np.repeat(line(t), [len(a) for a in angles], 0),
        origin=start + 0.5 * along + (centre - start - ((centre - start) @ x) * x), frame=np.stack([x, y, z], 1),
        length=length, radius=radius, depth=depth,
    )  # fmt: skip


def trunk_shell(body: Body, outward: Array, tissue: Tissue) -> Shell:
    """A patch over the belly between the lower ribs and the pelvis; the border ring is pinned."""
    x, z = np.array([0.0, 0.0, 1.0]), outward / np.linalg.norm(outward)
    y = np.cross(z, x)
    low, high = belly_span(body)
    faces = body.vertices[body.faces]
    triangles = faces[
        (np.abs(faces[:, :, 2].mean(1) - (low + high) / 2) < (high - low) / 2 + 0.04)
        & (np.abs(faces[:, :, 0].mean(1)) < 0.2)
    ]
    half_length, half_width = (high - low) / 2 - BELLY_FINE_MARGIN_M, belly_half_width(body)
    fine_half_width = min(BELLY_FINE_HALF_WIDTH_M, half_width - BELLY_FINE_MARGIN_M)

    def away(t: Array, s: Array) -> Array:
        return np.hypot(distance_outside(t - (low + high) / 2, half_length), distance_outside(s, fine_half_width))

    def spacing(distance: Array) -> Array:
        return np.clip(tissue.spacing_m + GROWTH * distance, None, tissue.coarse_spacing_m)

    back = np.array([0.0, body.joint_centre["thorax"][1], 0.0])

    def foot(t: Array | float, s: Array) -> Array:
        """(n, 3) points of the back plane."""
        return back + np.asarray(s)[:, None] * y + np.broadcast_to(t, np.shape(s))[:, None] * x

    heights = np.linspace(low, high, BELLY_SAMPLES)
    breadths = np.linspace(-half_width, half_width, BELLY_SAMPLES)
    surface, ahead = Triangles(triangles), np.repeat(z[None], BELLY_SAMPLES, 0)
    measured = np.array([surface.first_hits(foot(h, breadths), ahead) for h in heights])
    measured = bridged(heights, breadths, measured, NAVEL_BALL_M)
    sigma = SMOOTHING_M / (high - low), SMOOTHING_M / (2 * half_width)
    depth_at = smooth_field(heights, breadths, measured, sigma=sigma, wrap=False)

    def slant(at: Array, to: Array) -> Array:
        """Length of the surface over a unit of the plane, between points (n, 2) of it."""
        gap = np.linalg.norm(to - at, axis=1)
        return np.hypot(1.0, (depth_at(to[:, 0], to[:, 1]) - depth_at(at[:, 0], at[:, 1])) / gap)

    def step_along(u: Array) -> Array:
        middle = np.stack([u, np.zeros(len(u))], 1)
        return ROW_RATIO * spacing(away(u, np.zeros(len(u)))) / slant(middle - [1e-3, 0], middle + [1e-3, 0])

    rows, across, origins = [], [], []
    t = graded(low, high, step_along)
    for i, height in enumerate(t):

        def step(s: Array, height=height) -> Array:
            at = np.stack([np.full(len(s), height), s], 1)
            return spacing(away(height, s)) / slant(at - [0, 1e-3], at + [0, 1e-3])

        s = graded_from_middle(half_width, step, half_step=bool(i % 2))
        rows.append(foot(height, s) + depth_at(height, s)[:, None] * z)
        across.append(s)
        origins.append(foot(height, s))
    grid = np.stack([np.repeat(t, [len(a) for a in across]), np.concatenate(across)], 1)
    pinned = (grid[:, 0] == t[0]) | (grid[:, 0] == t[-1]) | (np.abs(grid[:, 1]) >= half_width - 1e-9)
    origin = back + (low + high) / 2 * x
    cell = _cell(tissue, BELLY_CELL_M)
    return _finish(
        rows, grid - [low, 0.0], pinned=pinned, fine=away(grid[:, 0], grid[:, 1]) <= 1e-9, cell_size=(cell, cell),
        across_m=np.ones(len(grid)), lean=BELLY_LEAN,
        axis_points=np.concatenate(origins), origin=origin, frame=np.stack([x, y, z], 1), length=high - low,
        radius=half_width, depth=float(depth_at((low + high) / 2, np.zeros(1))[0]),
    )  # fmt: skip


def belly_span(body: Body) -> tuple[float, float]:
    """Heights in the mesh frame between which the trunk's front is soft [m]."""
    return float(body.joint_centre["pelvis"][2]) + 0.02, float(body.joint_centre["thorax"][2]) + 0.07


def belly_half_width(body: Body) -> float:
    """Half the width of the belly's shell [m]."""
    low, high = belly_span(body)
    faces = body.vertices[body.faces_of("pelvis", "abdomen", "thorax", "left_thigh", "right_thigh")]
    heights = np.linspace(low, high, 15)
    middle = np.stack([np.zeros(15), np.full(15, body.joint_centre["thorax"][1]), heights], 1)
    breadth = Triangles(faces).first_hits(middle, np.tile([1.0, 0.0, 0.0], (15, 1)))
    return BELLY_WIDTH_SHARE * float(breadth.min())


def _cell(tissue: Tissue, size: float) -> float:
    """On a coarse mesh at least a step of it."""
    return max(size, tissue.spacing_m)


def _directions(y: Array, z: Array, theta: Array) -> Array:
    return np.cos(theta)[:, None] * z + np.sin(theta)[:, None] * y


def _centre_line(surface: Triangles, start: Array, x: Array, y: Array, z: Array, t: Array) -> Callable[[Array], Array]:
    """The line through the sections' centres (midpoints of opposite surface points), as a cubic along the limb."""
    directions = _directions(y, z, np.linspace(0, 2 * np.pi, 12, endpoint=False))
    off = np.zeros((len(t), 3))
    for _ in range(2):
        for i, at in enumerate(t):
            off[i] += surface.first_hits(start + at * x + off[i], directions) @ directions / 6
    fit = np.polynomial.Polynomial.fit
    across = [fit(t, off @ axis, 3) for axis in (y, z)]
    return lambda u: start + u[:, None] * x + across[0](u)[:, None] * y + across[1](u)[:, None] * z


def _bin(values: Array, low: float, high: float, count: int) -> npt.NDArray[np.int64]:
    """Number of the equal part of [low, high] that each value lies in, the nearest for those outside."""
    return np.clip(np.floor((values - low) / (high - low) * count).astype(np.int64), 0, count - 1)


SLIVER = 0.4
"""Of the median cell's area in its ring: a lighter cell is too light for the membrane at the longest step."""


def _without_slivers(column: npt.NDArray[np.int64], area: Array) -> npt.NDArray[np.int64]:
    """Cells of a ring, numbered across, each sliver joined to its neighbour toward the middle."""
    column = column.copy()
    middle = column.max() // 2
    enough = SLIVER * np.median(np.bincount(column, area)[np.unique(column)])
    for inward, numbers in ((1, range(middle)), (-1, range(column.max(), middle, -1))):
        for number in numbers:
            if area[column == number].sum() < enough:
                column[column == number] += inward
    return column


def _finish(
    rows: list[Array], grid: Array, *, pinned: npt.NDArray[np.bool_], fine: npt.NDArray[np.bool_],
    cell_size: tuple[float, float], across_m: Array, lean: float, axis_points: Array, origin: Array,
    frame: Array, length: float, radius: float, depth: float,
) -> Shell:  # fmt: skip
    vertices, triangles = np.concatenate(rows), zip_rows(rows)
    x = frame[:, 0]
    normals, area = normals_and_areas(vertices, triangles)
    if np.einsum("ij,ij->i", normals, vertices - axis_points).mean() < 0:
        triangles, normals = triangles[:, ::-1], -normals
    low, high, half = grid[~pinned, 0].min(), grid[~pinned, 0].max(), np.abs(grid[~pinned, 1]).max()
    rings = max(1, round((high - low) / cell_size[0]))
    ring = _bin(grid[:, 0], low, high, rings)
    key = np.full(len(grid), -1)
    for i in range(rings):
        mine = ~pinned & (ring == i)
        breadth = 2 * half * across_m[mine].mean()
        # An odd number: a cell's middle, not its edge, lies on top, where the tool meets the region most.
        columns = max(1, 2 * round((breadth / cell_size[1] - 1) / 2) + 1)
        key[mine] = 1000 * i + _without_slivers(_bin(grid[mine, 1], -half, half, columns), area[mine])
    free_keys = np.unique(key[~pinned])
    cell = np.where(pinned, -1, np.searchsorted(free_keys, key))
    frames = np.empty((len(free_keys), 3, 3))
    for k in range(len(free_keys)):
        mine = cell == k
        n = (area[mine, None] * normals[mine]).sum(0)
        n /= np.linalg.norm(n)
        tangent = x - (x @ n) * n
        tangent /= np.linalg.norm(tangent)
        frames[k] = np.stack([tangent, np.cross(n, tangent), n], 1)
    outward = np.where(pinned[:, None], normals, (1 - lean) * frames[cell, :, 2] + lean * normals)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return Shell(
        vertices=vertices, normals=normals, triangles=triangles, pinned=pinned, fine=fine & ~pinned, area=area,
        cell=cell, cell_frames=frames, inward=-outward,
        axis_points=axis_points, grid=grid, frame_origin=origin, frame=frame,
        length_m=length, radius_m=radius, axis_depth_m=depth,
    )  # fmt: skip
