"""A grid of lines on a region's skin, which makes visible how the skin gives way."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from carecontact.world.scene import Scene

F64 = npt.NDArray[np.float64]

LINE_M = 0.010
"""Distance between two lines, along the region and across it, as seen from the region's outward side."""
FACING = 0.15
"""Triangles whose normal has a smaller part along the outward axis have no lines."""
NEAR_M = 0.008
"""Skin farther from the region's shell has no lines."""
TOLERANCE_M = 0.0025
"""A line is drawn where nothing lies farther in front of it."""
FRACTION_BITS = 4
LINE_COLOUR, DARKNESS = (60, 30, 22), 0.42
"""A line's colour, and the share of it in a pixel that the line covers."""


@dataclass(frozen=True, kw_only=True)
class Eye:
    """A pinhole camera of one picture."""

    position: F64
    """(3,)"""
    axes: F64
    """(3, 3) rows right, down, forward in the world"""
    focal_px: float
    size: tuple[int, int]
    """(width, height)"""

    def pixels(self, points: F64) -> tuple[F64, F64]:
        """(N, 3) in the world -> (N, 2) pixels and (N,) distance along the optical axis [m]."""
        local = (points - self.position) @ self.axes.T
        depth = np.maximum(local[:, 2], 1e-3)
        middle = (np.array(self.size) - 1) / 2
        return self.focal_px * local[:, :2] / depth[:, None] + middle, local[:, 2]


class SkinGrid:
    """Lines as pairs of points on edges of the skin's triangles, found once in the bind pose."""

    def __init__(self, scene: Scene, region: str) -> None:
        """``region``: a soft one. The scene is a film's (``film.skin.film_scene``)."""
        model, frame = scene.model, scene.frames[region]
        bind = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)[: model.nskinvert]
        faces = np.asarray(model.skin_face).reshape(-1, 3)
        local = (bind - frame.origin) @ frame.axes
        a, b, c = (local[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        upward = normal[:, 2] > FACING * np.linalg.norm(normal, axis=1)
        near = KDTree(scene.regions[region].shell.vertices).query(bind, distance_upper_bound=NEAR_M)[0] < NEAR_M
        inside = np.abs(local[:, 0]) < frame.size_m[0] / 2
        faces = faces[upward & (near & inside)[faces].all(1)]
        pairs, shares = zip(*(_crossings(local[:, axis] / LINE_M, faces) for axis in (0, 1)), strict=True)
        self._pairs, self._shares = np.concatenate(pairs), np.concatenate(shares)

    def draw(self, picture: npt.NDArray[np.uint8], depth: npt.NDArray[np.float32], vertices: F64, eye: Eye) -> None:
        """Darken the lines in a picture, in place.

        Args:
            depth: (H, W) of what was drawn [m].
            vertices: (V, 3) of the skin in the world.
        """
        ends = vertices[self._pairs]
        points = ends[..., 0, :] + self._shares[..., None] * (ends[..., 1, :] - ends[..., 0, :])
        pixels, distance = eye.pixels(points.reshape(-1, 3))
        width, height = eye.size
        column, row = (np.round(pixels[:, k]).astype(int) for k in (0, 1))
        seen = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (distance > 0)
        seen[seen] = distance[seen] < depth[row[seen], column[seen]] + TOLERANCE_M
        both = seen.reshape(-1, 2).all(1)
        lines = np.round(pixels.reshape(-1, 2, 2)[both] * (1 << FRACTION_BITS)).astype(np.int32)
        mask = np.zeros((height, width), np.uint8)
        cv2.polylines(mask, list(lines), False, 255, 1, cv2.LINE_AA, FRACTION_BITS)
        on = mask > 0
        share = mask[on][:, None].astype(np.float32) * (DARKNESS / 255)
        picture[on] = (picture[on] * (1 - share) + np.array(LINE_COLOUR) * share).astype(np.uint8)


def _crossings(value: F64, faces: npt.NDArray[np.int32]) -> tuple[npt.NDArray[np.int64], F64]:
    """Return where whole numbers of a value at the vertices cross triangles: (L, 2, 2) vertices of the two edges, and
    (L, 2) where on them."""
    low, high = np.ceil(value[faces].min(1)), np.floor(value[faces].max(1))
    pairs, shares = [], []
    for level in range(int(low.min()), int(high.max()) + 1):
        mine = faces[(low <= level) & (level <= high)]
        edges = np.stack([mine, np.roll(mine, -1, axis=1)], -1)
        at = value[edges]
        crossed = (at[..., 0] < level) != (at[..., 1] < level)
        two = crossed.sum(1) == 2
        edges, at = edges[two][crossed[two]], at[two][crossed[two]]
        pairs.append(edges.reshape(-1, 2, 2))
        shares.append(((level - at[:, 0]) / (at[:, 1] - at[:, 0])).reshape(-1, 2))
    return np.concatenate(pairs).astype(np.int64), np.concatenate(shares)


def eye_of(made: mujoco.MjvScene, size: tuple[int, int]) -> Eye:
    """Return the camera that MuJoCo will draw a prepared scene with: the mean of its two eyes."""
    left, right = made.camera[0], made.camera[1]
    position = (np.array(left.pos) + np.array(right.pos)) / 2
    forward, up = np.array(left.forward, np.float64), np.array(left.up, np.float64)
    focal = size[1] / 2 * left.frustum_near / ((left.frustum_top - left.frustum_bottom) / 2)
    return Eye(
        position=position.astype(np.float64), axes=np.stack([np.cross(forward, up), -up, forward]),
        focal_px=float(focal), size=size,
    )  # fmt: skip
