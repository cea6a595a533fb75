"""Triangulated surfaces: between rows of points, refined where a dent should be visible, with normals and areas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from carecontact.human.body import Array, Body

Indices = npt.NDArray[np.int64]


def graded(low: float, high: float, spacing: Callable[[Array], Array]) -> Array:
    """Return coordinates from ``low`` to ``high``, both included, nowhere farther apart than ``spacing`` allows.

    Args:
        spacing: (n,) coordinates -> (n,) widest step there.
    """
    fine, steps = _step_count(low, high, spacing)
    count = max(1, int(np.ceil(steps[-1] - 1e-6)))
    return np.interp(np.arange(count + 1) / count * steps[-1], steps, fine)


def graded_from_middle(half_width: float, spacing: Callable[[Array], Array], *, half_step: bool) -> Array:
    """Return coordinates from ``-half_width`` to ``half_width``, symmetric, so that the rows of a lattice fit at its
    middle.

    Args:
        half_step: whether the first points are half a step from the middle, as in every other row of a triangular
            lattice, and not at the middle.
    """
    fine, steps = _step_count(0.0, half_width, spacing)
    shift = 0.5 if half_step else 0.0
    count = max(1, int(np.ceil(steps[-1] - shift - 1e-6)))
    at = (np.arange(count) + shift) * steps[-1] / (count + shift)
    side = np.concatenate([np.interp(at, steps, fine), [half_width]])
    return np.concatenate([-side[::-1], side if half_step else side[1:]])


def _step_count(low: float, high: float, spacing: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Return fine coordinates, and for each the number of steps of the wanted width before it."""
    fine = np.linspace(low, high, 2001)
    middle = (fine[1:] + fine[:-1]) / 2
    return fine, np.concatenate([[0.0], np.cumsum(np.diff(fine) / spacing(middle))])


def distance_outside(u: Array, half_width: float) -> Array:
    return np.maximum(np.abs(u) - half_width, 0.0)


def zip_rows(rows: list[Array]) -> Indices:
    """Return triangles (M, 3) between neighbouring rows of points (n_i, 3), which may differ in length.

    Between two rows, from first to last points, the row with the shorter next diagonal advances.
    """
    first = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    triangles: list[tuple[int, int, int]] = []
    for k, (a, b) in enumerate(pairwise(rows)):
        i = j = 0
        while i < len(a) - 1 or j < len(b) - 1:
            along_a = i < len(a) - 1 and (
                j == len(b) - 1 or np.linalg.norm(a[i + 1] - b[j]) <= np.linalg.norm(b[j + 1] - a[i])
            )
            p, q = int(first[k] + i), int(first[k + 1] + j)
            triangles.append((p, p + 1, q) if along_a else (p, q + 1, q))
            i, j = (i + 1, j) if along_a else (i, j + 1)
    return np.array(triangles)


def normals_and_areas(vertices: Array, triangles: Indices) -> tuple[Array, Array]:
    """Return the vertices' unit normals (N, 3), by the triangles' winding, and shares (N,) of the area [m^2]."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals, area = np.zeros_like(vertices), np.zeros(len(vertices))
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
        np.add.at(area, triangles[:, k], np.linalg.norm(face, axis=1) / 6)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True), area


def smooth_field(
    u: Array, v: Array, values: Array, *, sigma: tuple[float, float], wrap: bool
) -> Callable[[float | Array, Array], Array]:
    """Return a smooth function of (u, v) from values on a regular grid, blurred by a Gaussian.

    Args:
        values: (len(u), len(v)).
        sigma: standard deviations as shares of the spans of u and v.
        wrap: v is an angle whose ends meet; the last column repeats the first.

    The blur does not change a linear trend, also at the borders: it is applied to the residual of a plane, and samples
    beyond a border are point reflections of those inside.
    """
    from scipy.interpolate import RectBivariateSpline
    from scipy.ndimage import gaussian_filter1d

    width = [s * (n - 1) for s, n in zip(sigma, values.shape, strict=True)]

    def reflected(a: Array, count: int) -> Array:
        return np.concatenate([2 * a[:1] - a[count:0:-1], a, 2 * a[-1:] - a[-2 : -count - 2 : -1]])

    count = min(len(u) - 1, int(np.ceil(4 * width[0])) + 1)
    out = gaussian_filter1d(reflected(values, count), width[0], axis=0)[count:-count]
    if wrap:
        out = gaussian_filter1d(out[:, :-1], width[1], axis=1, mode="wrap")
        out = np.concatenate([out, out[:, :1]], 1)
    else:
        count = min(len(v) - 1, int(np.ceil(4 * width[1])) + 1)
        out = gaussian_filter1d(reflected(out.T, count), width[1], axis=0)[count:-count].T
    spline = RectBivariateSpline(u, v, out)
    return lambda at_u, at_v: spline.ev(np.broadcast_to(at_u, np.shape(at_v)), at_v)


def bridged(u: Array, v: Array, heights: Array, radius_m: float) -> Array:
    """Return heights (len(u), len(v)) [m] of the surface as a rolling ball of this radius sees it: a grey closing.

    Args:
        u, v: evenly spaced coordinates [m].
        heights: (len(u), len(v)) [m].

    A plane is not changed: samples beyond a border are point reflections of those inside.
    """
    from scipy.ndimage import grey_closing

    steps = [float(axis[1] - axis[0]) for axis in (u, v)]
    # Up to 0.9 of the radius: farther out, the ball is steeper than any surface that is seen from above.
    reach = [int(0.9 * radius_m / step) for step in steps]
    across = np.meshgrid(*(np.arange(-n, n + 1) * step for n, step in zip(reach, steps, strict=True)), indexing="ij")
    apart = across[0] ** 2 + across[1] ** 2
    ball = np.sqrt(np.maximum(radius_m**2 - apart, 0.0)) - radius_m
    margin = [min(2 * n, size - 1) for n, size in zip(reach, heights.shape, strict=True)]
    wide = np.pad(heights, [(n, n) for n in margin], mode="reflect", reflect_type="odd")
    closed = grey_closing(wide, footprint=apart < (0.9 * radius_m) ** 2, structure=ball)
    # A closing is never below the surface; rounding may put it there.
    return np.maximum(heights, closed[margin[0] : -margin[0] or None, margin[1] : -margin[1] or None])


def refined(body: Body, *segments: str, times: int) -> Body:
    """Return a copy of a body whose faces on ``segments`` are split into four, ``times`` times, and rounded.

    New points are moved toward the tangent planes at the ends of their edge (Phong tessellation, Boubekeur and Alexa
    2008); otherwise, shading would show every old triangle. At the border of the segments they stay on the straight
    edge, so that no gap appears. Weights and texture are kept. The copy is for drawing only: regions and masses come
    from the original body.
    """
    indices = [body.segments.index(segment) for segment in segments]
    for _ in range(times):
        body = _split(body, indices)
    return body


def _split(body: Body, indices: list[int]) -> Body:
    chosen = np.isin(body.owner[body.faces], indices).all(1)
    faces, uv_faces = body.faces[chosen], body.uv_faces[chosen]
    edges, at = _midpoints(faces)
    uv_edges, uv_at = _midpoints(uv_faces)
    mid_faces, mid_uv_faces = at + len(body.vertices), uv_at + len(body.uv)

    dense = np.zeros((len(body.vertices), len(body.segments)))
    np.put_along_axis(dense, body.weight_segment, body.weight, 1)
    dense = (dense[edges[:, 0]] + dense[edges[:, 1]]) / 2
    order = np.argsort(-dense, axis=1)[:, :4]
    weight = np.take_along_axis(dense, order, 1)
    return replace(
        body,
        vertices=np.concatenate([body.vertices, _rounded(body, edges, inner=np.bincount(at.ravel()) == 2)]),
        faces=np.concatenate([body.faces[~chosen], _four(faces, mid_faces)]),
        uv=np.concatenate([body.uv, body.uv[uv_edges].mean(1)]),
        uv_faces=np.concatenate([body.uv_faces[~chosen], _four(uv_faces, mid_uv_faces)]),
        weight_segment=np.concatenate([body.weight_segment, order]),
        weight=np.concatenate([body.weight, weight / weight.sum(1, keepdims=True)]),
        is_eye=np.concatenate([body.is_eye, np.zeros(len(edges), bool)]),
    )


ROUNDING = 0.75
"""Share of the way to the tangent planes, as the method's authors recommend."""


def _rounded(body: Body, edges: Indices, *, inner: npt.NDArray[np.bool_]) -> Array:
    """Return new points (E, 3) on the edges; only those of ``inner`` edges leave the straight line."""
    middle = body.vertices[edges].mean(1)
    offset = middle[:, None] - body.vertices[edges]
    normal = normals_and_areas(body.vertices, body.faces)[0][edges]
    onto_planes = (np.einsum("eki,eki->ek", offset, normal)[..., None] * normal).mean(1)
    return middle - np.where(inner, ROUNDING, 0.0)[:, None] * onto_planes


def _midpoints(faces: Indices) -> tuple[Indices, Indices]:
    """Return the unique edges (E, 2), and for each face (F, 3) its edges between corners 0-1, 1-2 and 2-0."""
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], -1), axis=-1).reshape(-1, 2)
    edges, inverse = np.unique(pairs, axis=0, return_inverse=True)
    return edges, inverse.reshape(-1, 3)


def _four(faces: Indices, middle: Indices) -> Indices:
    a, b, c = faces.T
    ab, bc, ca = middle.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, 1) for part in parts])
