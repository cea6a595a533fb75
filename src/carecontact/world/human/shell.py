"""Sample a soft region's shell from the body's own surface, in the mesh frame of the bind pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.errors import SceneError
from carecontact.world.human.body import Array, Body

PINNED_BEYOND_DEG = {"forearm": 128.0, "upper_arm": 105.0}
"""Round a limb from its top. The forearm is also pushed from the side: 90 degrees must lie between free vertices."""
FINE_HALF_LENGTH_M = 0.085
"""Scrub strokes of +-60 mm plus two tool radii."""
BELLY_HALF_WIDTH_M = 0.135
LIMB_SPAN = {"forearm": (0.05, 0.96), "upper_arm": (0.25, 0.97)}
"""Share of the joint-to-joint line that a shell covers; the upper arm's begins under the armpit, where it is a tube."""


@dataclass(frozen=True, kw_only=True)
class Shell:
    """A structured grid of I x J vertices: i along the region's axis, j across it."""

    vertices: Array
    """(N, 3) mesh frame"""
    normals: Array
    """(N, 3) outward unit"""
    tangents: Array
    """(N, 3) unit, along the region's axis"""
    triangles: npt.NDArray[np.int64]
    """(M, 3) wound outward"""
    pinned: npt.NDArray[np.bool_]
    """(N,) fixed to the bone: border ring and underside"""
    area: Array
    """(N,) share of the surface [m^2]"""
    axis_points: Array
    """(N, 3) point of the region's axis (belly: of its back plane) inward of each vertex"""
    frame_origin: Array
    frame: Array
    """(3, 3) columns x (along), y, z (outward at the middle): the region frame in the mesh frame"""
    length_m: float
    radius_m: float
    axis_depth_m: float
    """Distance of the axis under the surface at the middle."""


def limb_shell(body: Body, segment: str, outward: Array, tissue: Tissue) -> Shell:
    """A tube around a limb, fine where its normal faces ``outward`` and mid-length, pinned at the ends and below.

    Args:
        outward: (3,) direction in the mesh frame that faces up in the lying pose.
    """
    start, along = body.joint_centre[segment], body.axis_vector(segment)
    length = float(np.linalg.norm(along))
    x = along / length
    z = outward - (outward @ x) * x
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    low, high = LIMB_SPAN[segment.partition("_")[2]]
    span = np.array([low, high]) * length
    fine = np.clip(span.mean() + np.array([-FINE_HALF_LENGTH_M, FINE_HALF_LENGTH_M]), *(span + [0.01, -0.01]))
    t = graded(span, fine, tissue.spacing_m, tissue.coarse_spacing_m)
    faces = body.vertices[body.faces]
    triangles = faces[np.abs((faces.mean(1) - (start + along / 2)) @ x) < length / 2 + 0.03]
    middle = triangles.mean(1) - start
    triangles = triangles[np.linalg.norm(middle - np.outer(middle @ x, x), axis=1) < 0.12]
    # The joint line runs off centre: measure round the section's own centre.
    probe = _section_centres(triangles, start, x, y, z, t)
    radius = float(np.median(_cast(triangles, probe[len(t) // 2][None], _ring(y, z, 12))))
    fine_angle, coarse_angle = tissue.spacing_m / radius, tissue.coarse_spacing_m / radius
    half = np.radians(150.0)
    theta = graded(np.array([-half, half]), np.radians([-62.0, 62.0]), fine_angle, coarse_angle)
    directions = np.cos(theta)[:, None] * z + np.sin(theta)[:, None] * y
    vertices = np.empty((len(t), len(theta), 3))
    for i, centre in enumerate(probe):
        vertices[i] = (
            centre + _cast(triangles, np.repeat(centre[None], len(theta), 0), directions)[:, None] * directions
        )
    pinned = np.zeros((len(t), len(theta)), bool)
    pinned[[0, -1]] = True
    pinned[:, np.abs(theta) > np.radians(PINNED_BEYOND_DEG[segment.partition("_")[2]])] = True
    surface = vertices[len(t) // 2, np.abs(theta).argmin()]
    centre = probe[len(t) // 2]
    depth = float((surface - centre) @ z)
    origin = start + 0.5 * along + (centre - start - ((centre - start) @ x) * x)
    axis_points = np.repeat(probe[:, None], len(theta), 1)
    return _finish(vertices, pinned, axis_points, x, origin, x, z, length, radius, depth)


def trunk_shell(body: Body, outward: Array, tissue: Tissue) -> Shell:
    """A patch over the belly between the lower ribs and the pelvis; the border ring is pinned."""
    x, z = np.array([0.0, 0.0, 1.0]), outward / np.linalg.norm(outward)
    y = np.cross(z, x)
    low, high = belly_span(body)
    t = graded(np.array([low, high]), np.array([low + 0.03, high - 0.03]), tissue.spacing_m, tissue.coarse_spacing_m)
    s = graded(
        np.array([-BELLY_HALF_WIDTH_M, BELLY_HALF_WIDTH_M]),
        np.array([-0.085, 0.085]),
        tissue.spacing_m,
        tissue.coarse_spacing_m,
    )
    trunk = body.vertices[body.faces]
    centre_height = (low + high) / 2
    triangles = trunk[
        (np.abs(trunk[:, :, 2].mean(1) - centre_height) < (high - low) / 2 + 0.04)
        & (np.abs(trunk[:, :, 0].mean(1)) < 0.2)
    ]
    back = np.array([0.0, body.joint_centre["thorax"][1], 0.0])
    vertices, axis_points = np.empty((2, len(t), len(s), 3))
    for i, height in enumerate(t):
        origins = back + s[:, None] * y + height * x
        axis_points[i] = origins
        vertices[i] = origins + _cast(triangles, origins, np.repeat(z[None], len(s), 0))[:, None] * z
    pinned = np.zeros((len(t), len(s)), bool)
    pinned[[0, -1]] = True
    pinned[:, [0, -1]] = True
    surface = vertices[len(t) // 2, np.abs(s).argmin()]
    depth = float((surface - back) @ z)
    origin = back + centre_height * x
    return _finish(vertices, pinned, axis_points, x, origin, x, z, high - low, BELLY_HALF_WIDTH_M, depth)


def belly_span(body: Body) -> tuple[float, float]:
    """Heights in the mesh frame between which the trunk's front is soft [m]."""
    return float(body.joint_centre["pelvis"][2]) + 0.02, float(body.joint_centre["thorax"][2]) + 0.07


def graded(span: Array, fine: Array, spacing: float, coarse: float) -> Array:
    """Coordinates over ``span``: at most ``spacing`` apart inside ``fine``, about ``coarse`` outside."""
    inner = np.linspace(fine[0], fine[1], int(np.ceil((fine[1] - fine[0]) / spacing - 1e-9)) + 1)

    def outer(distance: float) -> Array:
        if distance <= 0:
            return np.zeros(0)
        count = max(1, round(distance / coarse))
        steps = np.arange(1, count + 1) / count
        return distance * steps

    left, right = outer(fine[0] - span[0]), outer(span[1] - fine[1])
    return np.concatenate([fine[0] - left[::-1], inner, fine[1] + right])


def _ring(y: Array, z: Array, count: int) -> Array:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.cos(angle)[:, None] * z + np.sin(angle)[:, None] * y


def _section_centres(triangles: Array, start: Array, x: Array, y: Array, z: Array, t: Array) -> Array:
    """(len(t), 3) centre of each cross-section: midpoint of opposite surface points, twice."""
    directions = _ring(y, z, 12)
    out = start + t[:, None] * x
    for _ in range(2):
        hits = _cast(triangles, np.repeat(out, 12, 0), np.tile(directions, (len(t), 1))).reshape(len(t), 12)
        out = out + np.einsum("ij,jk->ik", hits, directions) / 6
    return out


def _cast(triangles: Array, origins: Array, directions: Array) -> Array:
    """Distance to the first hit along each ray (Moeller and Trumbore 1997). Raises SceneError when a ray misses."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    first = np.empty(len(directions))
    for k, (o, d) in enumerate(zip(np.broadcast_to(origins, directions.shape), directions, strict=True)):
        p = np.cross(d, e2)
        det = np.einsum("ij,ij->i", e1, p)
        ok = np.abs(det) > 1e-12
        inverse = np.where(ok, 1 / np.where(ok, det, 1), 0)
        s = o - a
        u = np.einsum("ij,ij->i", s, p) * inverse
        q = np.cross(s, e1)
        v = q @ d * inverse
        distance = np.einsum("ij,ij->i", e2, q) * inverse
        hit = ok & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
        if not hit.any():
            raise SceneError(
                f"a ray from {np.round(o, 3).tolist()} misses the body's surface: the region does not fit this body"
            )
        first[k] = distance[hit].min()
    return first


def _finish(
    grid: Array, pinned: npt.NDArray[np.bool_], axis_points: Array, axis: Array, origin: Array, x: Array, z: Array,
    length: float, radius: float, depth: float,
) -> Shell:  # fmt: skip
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    even = ((np.arange(rows - 1)[:, None] + np.arange(columns - 1)) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, d], -1), np.stack([a, b, c], -1))
    second = np.where(even, np.stack([a, d, c], -1), np.stack([b, d, c], -1))
    triangles = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    vertices = grid.reshape(-1, 3)
    face = np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    )
    centre = vertices[triangles].mean(1)
    outward = centre - origin
    outward -= np.outer(outward @ x, x)
    if (np.einsum("ij,ij->i", face, outward) < 0).mean() > 0.5:
        triangles, face = triangles[:, ::-1], -face
    normals, area = np.zeros_like(vertices), np.zeros(len(vertices))
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
        np.add.at(area, triangles[:, k], np.linalg.norm(face, axis=1) / 6)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = axis - np.outer(normals @ axis, np.ones(3)) * normals
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    return Shell(
        vertices=vertices, normals=normals, tangents=tangents, triangles=triangles, pinned=pinned.ravel(), area=area,
        axis_points=axis_points.reshape(-1, 3),
        frame_origin=origin, frame=np.stack([x, np.cross(z, x), z], 1), length_m=length, radius_m=radius,
        axis_depth_m=depth,
    )  # fmt: skip
