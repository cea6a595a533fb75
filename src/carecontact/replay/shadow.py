"""Soft shadows of a film, from the depth that its camera and its lamp see.

OpenGL's own shadows have hard, jagged edges, and MuJoCo draws the whole world twice more for them. Here the lamp sees
the world once, and each pixel asks which part of a small square of the lamp's picture lies in front of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import Image

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

MAP_PX = 512
"""Pixels of the lamp's picture, each way."""
LAMP_DISTANCE_M = 2.0
NEAR_M = 0.05
"""The lamp sees what lies between this distance and twice its own distance from the middle."""
TAPS_PX = 1.3 * np.array([-1.5, -0.5, 0.5, 1.5])
"""Where the lamp's picture is read round each point, along both of its axes: an edge becomes 5 of its pixels wide."""
BIAS_M = 0.005
"""What is nearer than this in front of a point casts no shadow on it."""
STEEPEST = 4.0
"""Where a surface descends along the light, its own neighbours in the lamp's picture lie in front of it. The bias grows
with this slope, up to so many metres for each metre across the light: steeper surfaces receive little of it."""
EVERY = 2
"""Shadows are found for one pixel out of so many, along both axes."""


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

    def seen(self, depth: F32, every: int) -> F32:
        """(H, W) depth [m] -> (h, w, 3) places in the camera's axes [m], for one pixel out of ``every`` each way."""
        (width, height), depth = self.size, depth[::every, ::every]
        x = (np.arange(0, width, every, dtype=np.float32) - (width - 1) / 2) / np.float32(self.focal_px)
        y = (np.arange(0, height, every, dtype=np.float32) - (height - 1) / 2) / np.float32(self.focal_px)
        return np.stack([x * depth, y[:, None] * depth, depth], -1, dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A distant lamp that shines on a square round a place."""

    look_at: F64
    """(3,) [m]"""
    axes: F64
    """(3, 3) rows right, down, forward in the world"""
    radius_m: float
    """Half the side of the square."""

    @classmethod
    def of(cls, look_at: F64, direction: F64, radius_m: float) -> Lamp:
        """``direction``: (3,) of its light, not vertical, of unit length."""
        right = np.cross(direction, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return cls(look_at=look_at, axes=np.stack([right, np.cross(direction, right), direction]), radius_m=radius_m)

    def aim(self, cameras: Sequence[mujoco.MjvGLCamera]) -> None:
        """Let cameras of a prepared scene look along the light."""
        for camera in cameras:
            camera.pos[:] = self.look_at - LAMP_DISTANCE_M * self.axes[2]
            camera.forward[:], camera.up[:] = self.axes[2], -self.axes[1]
            camera.orthographic, camera.frustum_center, camera.frustum_width = 1, 0.0, self.radius_m
            camera.frustum_bottom, camera.frustum_top = -self.radius_m, self.radius_m
            camera.frustum_near, camera.frustum_far = NEAR_M, 2 * LAMP_DISTANCE_M

    def lit(self, places: F32, facing: F32, height_m: F32) -> F32:
        """Return how much of the light reaches places, from 0 to 1.

        Args:
            places: (..., 3) in the axes of the lamp, from ``look_at`` [m].
            facing: (...) cosine between the surface's normal there and the direction to the lamp.
            height_m: (N, N) what the lamp sees, along its third axis from ``look_at`` [m].
        """
        count = len(height_m)
        column, row = ((places[..., k] / self.radius_m + 1) * (count / 2) - 0.5 for k in (0, 1))
        reach = float(np.abs(TAPS_PX).max())
        inside = (np.minimum(column, row) > reach) & (np.maximum(column, row) < count - 1 - reach)
        out = np.ones(inside.shape, np.float32)
        cosine = np.clip(np.abs(facing[inside]), 1e-3, 1)
        slope = np.minimum(np.sqrt(1 - cosine**2) / cosine, STEEPEST)
        bias_m = BIAS_M + (reach + 1) * (2 * self.radius_m / count) * slope
        points = np.stack([row[inside], column[inside], places[inside][:, 2] - bias_m], dtype=np.float32)

        def reached(at: F32, taps: Sequence[tuple[float, float]]) -> F32:
            found = np.zeros(at.shape[1], np.float32)
            for down, right in taps:
                found += (
                    height_m[(at[0] + (down + 0.5)).astype(np.int32), (at[1] + (right + 0.5)).astype(np.int32)] > at[2]
                )
            return (found / len(taps)).astype(np.float32)

        corners = [(a, b) for a in TAPS_PX[[0, -1]] for b in TAPS_PX[[0, -1]]]
        part = reached(points, corners)
        edge = (part > 0) & (part < 1)  # elsewhere, all of the light comes through or none
        part[edge] = reached(points[:, edge], [(a, b) for a in TAPS_PX for b in TAPS_PX])
        out[inside] = part
        return out


def metres_of_lamp(buffer: F32) -> F32:
    """MuJoCo's depth buffer -> metres along the lamp's third axis, from the middle of what it shines on."""
    return (NEAR_M + (1 - buffer) * (2 * LAMP_DISTANCE_M - NEAR_M) - LAMP_DISTANCE_M).astype(np.float32)


def shade(
    picture: npt.NDArray[np.uint8],
    metres: F32,
    edge: npt.NDArray[np.bool_],
    eye: Eye,
    lamp: Lamp,
    height_m: F32,
    key_share: Callable[[F32], F32],
) -> None:
    """Darken what lies in the shadow, in place.

    Args:
        picture: (H, W, 3) drawn as if nothing cast a shadow.
        metres: (H, W) depth of its pixels.
        edge: (H, W) where an outline is near (``edges``): there, light comes from the neighbour of like depth.
        height_m: (``MAP_PX``, ``MAP_PX``) what the lamp sees (``metres_of_lamp``).
        key_share: which part of the brightness of surfaces comes from the lamp, for their normals (h, w, 3) in the
            world.
    """
    seen = eye.seen(metres, EVERY)
    turn = (eye.axes @ lamp.axes.T).astype(np.float32)
    places = seen @ turn + ((eye.position - lamp.look_at) @ lamp.axes.T).astype(np.float32)
    normal = np.cross(_slope(seen, 0), _slope(seen, 1))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    normal = normal @ eye.axes.astype(np.float32)
    dark = (1 - lamp.lit(places, -(normal @ lamp.axes[2].astype(np.float32)), height_m)) * key_share(normal)
    light = 1 - dark
    full = np.array(Image.fromarray(light).resize((picture.shape[1], picture.shape[0]), Image.Resampling.BILINEAR))
    row, column = np.nonzero(edge)
    far, near = seen[..., 2], metres[row, column]
    best, apart = light[row // EVERY, column // EVERY], np.full(len(row), np.inf, np.float32)
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1), (0, -1), (-1, 0)):
        at = (np.clip(row // EVERY + down, 0, len(light) - 1), np.clip(column // EVERY + right, 0, light.shape[1] - 1))
        off = np.abs(far[at] - near)
        best, apart = np.where(off < apart, light[at], best), np.minimum(off, apart)
    full[row, column] = best
    np.multiply(picture, full[..., None], out=picture, casting="unsafe")


def _slope(seen: F32, axis: int) -> F32:
    """Difference to the neighbour along an axis that is nearer in depth: the other may belong to another surface."""
    steps = np.diff(seen, axis=axis)
    first, last = (np.take(steps, [k], axis=axis) for k in (0, -1))
    before, after = np.concatenate([first, steps], axis), np.concatenate([steps, last], axis)
    return np.where(np.abs(before[..., 2:]) < np.abs(after[..., 2:]), before, after)


EDGE = 0.004
"""A pixel is on an edge where the inverse depth bends by more than this part of its own."""


def edges(buffer: F32) -> npt.NDArray[np.bool_]:
    """Return where outlines are in MuJoCo's depth buffer (H, W), whose values are straight along every plane."""
    edge = np.zeros(buffer.shape, bool)
    for on, values in ((edge, buffer), (edge.T, buffer.T)):
        on[1:-1] |= np.abs(values[:-2] - 2 * values[1:-1] + values[2:]) > EDGE * values[1:-1]
    return edge


def widened(edge: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return the pixels that are on an edge or next to one."""
    wide = edge.copy()
    for on, values in ((wide, edge), (wide.T, wide.T.copy())):
        on[1:] |= values[:-1]
        on[:-1] |= values[1:]
    return wide
