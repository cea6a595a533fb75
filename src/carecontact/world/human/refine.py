"""Splits the drawn skin into finer triangles where a dent should be visible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.world.human.body import Array, Body


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


Indices = npt.NDArray[np.int64]
ROUNDING = 0.75
"""Share of the way to the tangent planes, as the method's authors recommend."""


def _rounded(body: Body, edges: Indices, *, inner: npt.NDArray[np.bool_]) -> Array:
    """Return new points (E, 3) on the edges; only those of ``inner`` edges leave the straight line."""
    normals = np.zeros_like(body.vertices)
    corner = body.vertices[body.faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    for k in range(3):
        np.add.at(normals, body.faces[:, k], face)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    middle = body.vertices[edges].mean(1)
    offset = middle[:, None] - body.vertices[edges]
    normal = normals[edges]
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
