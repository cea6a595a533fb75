"""The cells of a shell: groups of vertices that glide together over the bone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

SLIVER = 0.4
"""Of the median cell's area in its ring: a lighter cell is too light for the membrane at the longest step."""


def cell_size(tissue: Tissue, size: float) -> float:
    """Return the cell's size [m], which on a coarse mesh is one step of it at least."""
    return max(size, tissue.spacing_m)


def cells_of(
    grid: Array, *, pinned: npt.NDArray[np.bool_], area: Array, size: tuple[float, float], across_m: Array
) -> Indices:
    """Return the (N,) number of each vertex's cell, -1 where it is pinned.

    Args:
        grid: (N, 2) place of each vertex along and across the region.
        pinned: (N,) whether the bone holds the vertex.
        area: (N,) share of the surface [m^2].
        size: length of a cell along the region and across it [m].
        across_m: (N,) metres in one unit of ``grid`` across the region.
    """
    low, high, half = grid[~pinned, 0].min(), grid[~pinned, 0].max(), np.abs(grid[~pinned, 1]).max()
    rings = max(1, round((high - low) / size[0]))
    ring = _bin(grid[:, 0], low, high, rings)
    key = np.full(len(grid), -1)
    for i in range(rings):
        mine = ~pinned & (ring == i)
        breadth = 2 * half * across_m[mine].mean()
        # An odd number: a cell's middle, not its edge, lies on top, where the tool meets the region most.
        columns = max(1, 2 * round((breadth / size[1] - 1) / 2) + 1)
        key[mine] = 1000 * i + _without_slivers(_bin(grid[mine, 1], -half, half, columns), area[mine])
    return np.where(pinned, -1, np.searchsorted(np.unique(key[~pinned]), key))


def frames_of(cell: Indices, *, normals: Array, area: Array, along: Array) -> Array:
    """Return the (C, 3, 3) frames of the cells; columns are tangent along the region, across it, and outward normal.

    Args:
        cell: (N,) number of each vertex's cell.
        normals: (N, 3) outward unit vectors.
        area: (N,) share of the surface [m^2].
        along: (3,) unit vector along the region.
    """
    frames = np.empty((cell.max() + 1, 3, 3))
    for k in range(len(frames)):
        mine = cell == k
        n = (area[mine, None] * normals[mine]).sum(0)
        n /= np.linalg.norm(n)
        tangent = along - (along @ n) * n
        tangent /= np.linalg.norm(tangent)
        frames[k] = np.stack([tangent, np.cross(n, tangent), n], 1)
    return frames


def _bin(values: Array, low: float, high: float, count: int) -> npt.NDArray[np.int64]:
    """Number of the equal part of [low, high] that each value lies in, the nearest for those outside."""
    return np.clip(np.floor((values - low) / (high - low) * count).astype(np.int64), 0, count - 1)


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
