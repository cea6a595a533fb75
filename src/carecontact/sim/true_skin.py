"""The visible skin as it lies in the world, for the scorer and for pictures."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

ALL_SIDES = 0b11110000
"""Four truths as ``np.packbits`` packs them."""


def skin_in_world(model: mujoco.MjModel, data: mujoco.MjData) -> F64:
    """(V, 3) vertices of the only skin, moved by its bones as MuJoCo draws it, without its inflation [m]."""
    vertices = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)
    placed = np.zeros_like(vertices)
    bind = np.zeros(9)
    for bone in range(model.nskinbone):
        start, count = int(model.skin_bonevertadr[bone]), int(model.skin_bonevertnum[bone])
        ids = model.skin_bonevertid[start : start + count]
        weight = np.asarray(model.skin_bonevertweight[start : start + count], np.float64)[:, None]
        body = int(model.skin_bonebodyid[bone])
        mujoco.mju_quat2Mat(bind, np.asarray(model.skin_bonebindquat[bone], np.float64))
        turn = data.xmat[body].reshape(3, 3) @ bind.reshape(3, 3).T
        placed[ids] += weight * ((vertices[ids] - model.skin_bonebindpos[bone]) @ turn.T + data.xpos[body])
    return placed


def top_of_skin(vertices: F64, faces: npt.NDArray[np.integer], place: npt.ArrayLike) -> float:
    """Height [m] of the highest skin on the vertical line through a place (2,); NaN if it meets none."""
    # On which sides of the place each vertex lies; a triangle round the place has vertices on all four.
    flat = vertices[:, :2]
    sides = np.packbits(np.hstack([flat <= np.asarray(place), flat >= np.asarray(place)]), axis=1)[:, 0]
    near = np.bitwise_or.reduce(sides[faces], axis=1) == ALL_SIDES
    a, b, c = np.moveaxis(vertices[faces[near]], 1, 0)
    # Barycentric coordinates of the place in each triangle's shadow.
    u, v, w = (b - a)[:, :2], (c - a)[:, :2], np.asarray(place, np.float64) - a[:, :2]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    upright = np.abs(area) < 1e-14
    area = np.where(upright, 1.0, area)
    beta = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    gamma = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    inside = ~upright & (beta >= -1e-9) & (gamma >= -1e-9) & (beta + gamma <= 1 + 1e-9)
    heights = a[:, 2] + beta * (b - a)[:, 2] + gamma * (c - a)[:, 2]
    return float(heights[inside].max()) if inside.any() else float("nan")
