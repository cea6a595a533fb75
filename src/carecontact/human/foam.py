"""A patch of foam on the skin of a soft region: where it lies, which cells it covers, and how it looks while the tool
wipes it away.

The patch is painted into the skin's texture and is nothing else: no geometry, no mass, no friction. Its middle and its
axes belong to the bone's frame, so that it moves with the limb.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.body import Array, Body
from carecontact.human.skeleton import RegionFrame, upward_in_bind
from carecontact.human.skin import TEXTURE_SIZE
from carecontact.human.soft_region import SoftRegion

Rgb = tuple[int, int, int]
Indices = npt.NDArray[np.int64]

EDGE_M = 0.004
"""Width over which the foam's edge fades into the skin: about two texels (assumed)."""
SMOOTH_M = 0.006
"""Standard deviation of the weights with which the shell's vertices give the middle's place and normal: about two of
their spacings."""
INSIDE = 0.98
"""Least share of the foam on the soft shell or, for a scrub, on declared cells, which alone say what was wiped."""
FLAT = 0.9
"""Share of the flat patch's area that is expected on the shell: the patch is counted by whole triangles, and beyond the
shell's border there are none."""
STEP = 0.05
"""Share of the way to the region's middle by which foam is moved until it lies inside."""
GROWN_TEXELS = 1.0
"""Texels [px] beyond a triangle's border that are painted with it, because the filter of the texture reads them."""


@dataclass(frozen=True, kw_only=True)
class Spot:
    """Where foam shall lie and what it looks like, before there is a body."""

    along: float
    """Share of the region's length from the end nearer the trunk (abdomen: the feet)."""
    around_rad: float
    """About the region's axis, from the side that faces up."""
    half_m: tuple[float, float]
    """Half length along the region and half width across it."""
    room_m: float
    """Least distance between the patch and either end of the region."""
    colour: Rgb
    on_cells: bool
    """Whether the patch has to lie on declared cells, and not only on the region's soft shell; it is moved toward the
    region's middle until it does."""


@dataclass(frozen=True, kw_only=True)
class FoamPatch:
    """Foam on one body."""

    middle: Array
    """(3,) on the skin, in the region's frame [m]"""
    axes: Array
    """(3, 3) columns: along the region on the skin, across it, outward"""
    half_m: tuple[float, float]
    colour: Rgb
    cell_share: Array
    """(C,) share of each declared cell's area under foam"""
    texel: Indices
    """(K,) places in the texture, row by row"""
    strength: Array
    """(K,) share of the foam's colour in a texel before anything is wiped: 1, and less at the edge"""
    cell: Indices
    """(K,) the declared cell nearest to each texel"""
    skin: npt.NDArray[np.uint8]
    """(K, 3) colours under the foam"""

    def colours(self, left: Array) -> npt.NDArray[np.uint8]:
        """Return the texels (K, 3). ``left``: (C,) share of the foam that is left on each cell."""
        share = (self.strength * left[self.cell])[:, None]
        return np.rint((1 - share) * self.skin + share * np.array(self.colour)).astype(np.uint8)

    def paint(self, model: mujoco.MjModel, left: Array | None = None) -> None:
        """Write the foam into a compiled model's texture; the caller uploads the texture again. ``left``: as in
        ``colours``; None: all of it."""
        _texture(model)[self.texel] = self.colours(np.ones(len(self.cell_share)) if left is None else left)


def lay_foam(model: mujoco.MjModel, body: Body, region: SoftRegion, frame: RegionFrame, spot: Spot) -> FoamPatch:
    """Paint a patch onto the skin of a compiled model, whose texture is final otherwise, and return it."""
    shell = region.shell
    at = (shell.vertices - frame.origin) @ frame.axes
    normals = shell.normals @ frame.axes
    corners = shell.vertices[shell.triangles]
    middles = (corners.mean(1) - frame.origin) @ frame.axes
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    on_cell = region.cells.of_triangle >= 0

    def placed(along: float, around: float) -> tuple[Array, Array]:
        return _on_surface(at, normals, (along * float(frame.size_m[0]), around * spot.around_rad))

    most = max(0.0, 0.5 - (spot.half_m[0] + spot.room_m) / float(frame.size_m[0]))

    def inside(along: float, around: float) -> bool:
        if abs(along) > most:
            return False
        covered = areas * (_radius(middles, *placed(along, around), spot.half_m) < 1)
        on_it = covered[on_cell] if spot.on_cells else covered
        return bool(on_it.sum() >= INSIDE * max(covered.sum(), FLAT * np.pi * np.prod(spot.half_m)))

    ways = np.linspace(1.0, 0.0, round(1 / STEP) + 1).tolist()
    along = next((way * (spot.along - 0.5) for way in ways if inside(way * (spot.along - 0.5), 0.0)), 0.0)
    around = next((way for way in ways if inside(along, way)), 0.0)
    middle, axes = placed(along, around)
    covered = areas * (_radius(middles, middle, axes, spot.half_m) < 1)
    cells = region.cells
    share = np.bincount(cells.of_triangle[on_cell], covered[on_cell], len(cells.areas)) / cells.areas
    at_bind, axes_bind = frame.origin + frame.axes @ middle, frame.axes @ axes
    texel, points, strength = _covered_texels(body, at_bind, axes_bind, spot.half_m)
    nearest = np.linalg.norm(points[:, None] - cells.centres[None], axis=2).argmin(1)
    patch = FoamPatch(
        middle=middle,
        axes=axes,
        half_m=spot.half_m,
        colour=spot.colour,
        cell_share=share,
        texel=texel,
        strength=strength,
        cell=nearest,
        skin=_texture(model)[texel].copy(),
    )
    patch.paint(model)
    return patch


def lay_dressing(
    model: mujoco.MjModel, body: Body, segment: str, *, along: float, half_m: tuple[float, float], colour: Rgb
) -> None:
    """Paint a dressing onto the side of a limb that faces up, before any foam is laid.

    Args:
        along: place of its middle, as a share of the way from the segment's joint to the next one.
        half_m: half length along the limb and half width across it.
    """
    up, way, joint = upward_in_bind(body, segment), body.axis_vector(segment), body.joint_centre[segment]
    ahead = way - (way @ up) * up
    ahead /= np.linalg.norm(ahead)
    axes = np.stack([ahead, np.cross(up, ahead), up], 1)
    skin = body.vertices_of(segment)
    off = (skin - joint - along * way) @ axes
    above = off[:, 2] > 0
    middle = skin[above][np.linalg.norm(off[above, :2], axis=1).argmin()]
    texel, _, strength = _covered_texels(body, middle, axes, half_m)
    texture, share = _texture(model), strength[:, None]
    texture[texel] = np.rint((1 - share) * texture[texel] + share * np.array(colour)).astype(np.uint8)


def _texture(model: mujoco.MjModel) -> npt.NDArray[np.uint8]:
    """Return the skin's texels (TEXTURE_SIZE^2, 3) of a compiled model, to be changed in place."""
    start = int(model.tex_adr[model.texture("human_skin").id])
    return model.tex_data[start : start + 3 * TEXTURE_SIZE**2].reshape(-1, 3)


def _covered_texels(
    body: Body, middle: Array, axes: Array, half_m: tuple[float, float]
) -> tuple[Indices, Array, Array]:
    """Return the texels (K,) under a patch, their places (K, 3), and the share (K,) of the patch's colour in each.
    ``middle``, ``axes``: (3,) and (3, 3) in the mesh frame."""
    texel, points = _texels_near(body, middle, max(half_m) + EDGE_M)
    radius = _radius(points, middle, axes, half_m)
    strength = np.clip(0.5 + (1 - radius) * min(half_m) / EDGE_M, 0, 1)
    there = strength > 0
    return texel[there], points[there], strength[there]


def _on_surface(at: Array, normals: Array, place: tuple[float, float]) -> tuple[Array, Array]:
    """Return the point (3,) of a shell at a place along [m] and around [rad] a region, and its axes (3, 3): along,
    across, outward. ``at``, ``normals``: (N, 3) vertices and their normals, all in the region's frame."""
    out = np.hypot(at[:, 1], at[:, 2])
    turn = np.angle(np.exp(1j * (np.arctan2(at[:, 1], at[:, 2]) - place[1])))
    away = np.hypot(at[:, 0] - place[0], out * turn)
    weight = np.exp(-0.5 * ((away - away.min()) / SMOOTH_M) ** 2)
    radius, outward = weight @ out / weight.sum(), weight @ normals
    middle = np.array([place[0], radius * np.sin(place[1]), radius * np.cos(place[1])])
    outward /= np.linalg.norm(outward)
    along = np.array([1.0, 0.0, 0.0]) - outward[0] * outward
    along /= np.linalg.norm(along)
    return middle, np.stack([along, np.cross(outward, along), outward], 1)


def _radius(points: Array, middle: Array, axes: Array, half_m: tuple[float, float]) -> Array:
    """(n, 3) points in the region's frame -> (n,) their elliptic radius, 1 on the patch's border. Across the patch, the
    chord counts, which on a round limb is nearly the way over the skin."""
    off = points - middle
    along = off @ axes[:, 0]
    chord = np.sqrt(np.maximum((off**2).sum(1) - along**2, 0.0))
    return np.hypot(along / half_m[0], chord / half_m[1])


def _texels_near(body: Body, middle: Array, reach_m: float) -> tuple[Indices, Array]:
    """Return the texels (K,) of the skin near a point (3,), and their places (K, 3), in the mesh frame."""
    corners = body.vertices[body.faces]
    near = np.flatnonzero(np.linalg.norm(corners - middle, axis=2).min(1) < reach_m + 0.03)
    found: list[tuple[Indices, Array, Array]] = []
    for face in near.tolist():
        uv = body.uv[body.uv_faces[face]] * [1, -1] + [0, 1]
        a, b, c = uv * TEXTURE_SIZE
        double_area = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
        if abs(double_area) < 1e-9:
            continue
        low = np.maximum(np.floor(np.minimum(np.minimum(a, b), c) - GROWN_TEXELS), 0).astype(int)
        high = np.minimum(np.ceil(np.maximum(np.maximum(a, b), c) + GROWN_TEXELS), TEXTURE_SIZE).astype(int)
        column, row = (axis.ravel() for axis in np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])))
        at = np.stack([column, row], 1) + 0.5
        share = np.stack([_cross(c - b, at - b), _cross(a - c, at - c), _cross(b - a, at - a)], 1) / double_area
        heights = abs(double_area) / np.array([np.linalg.norm(edge) for edge in (c - b, a - c, b - a)])
        inside = (share * heights).min(1)
        mine = inside > -GROWN_TEXELS
        found.append((row[mine] * TEXTURE_SIZE + column[mine], share[mine] @ corners[face], inside[mine]))
    texel, points, inside = (np.concatenate(values) for values in zip(*found, strict=True))
    # Where triangles meet, a texel belongs to the one that it lies deepest inside.
    order = np.lexsort((-inside, texel))
    first = order[np.concatenate([[True], np.diff(texel[order]) > 0])]
    return texel[first].astype(np.int64), points[first]


def _cross(edge: Array, off: Array) -> Array:
    return edge[0] * off[:, 1] - edge[1] * off[:, 0]
