"""What every soft region's shell holds, and how one is finished from its rows of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.world.human.body import Array
from carecontact.world.human.shell.cells import cells_of, frames_of
from carecontact.world.human.surface_mesh import normals_and_areas, zip_rows

GROWTH = 0.4
"""Metres of spacing gained per metre away from the fine patch."""
ROW_RATIO = np.sqrt(3) / 2
"""Rows of a triangular lattice stand this much closer than the points in a row."""
SMOOTHING_M = 0.012
"""Standard deviation of the smoothing of the sampled surface: the body's own faces are 20 mm wide, and their ridges
made the force of a press vary by 9-16 % from place to place."""


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


def spacing(tissue: Tissue, distance: Array) -> Array:
    """Return the (n,) distance between neighbouring vertices [m] at (n,) distances outside the fine patch [m]."""
    return np.clip(tissue.spacing_m + GROWTH * distance, None, tissue.coarse_spacing_m)


def finish(
    rows: list[Array], grid: Array, *, pinned: npt.NDArray[np.bool_], fine: npt.NDArray[np.bool_],
    size_of_cells: tuple[float, float], across_m: Array, lean: float, axis_points: Array, origin: Array,
    frame: Array, length: float, radius: float, depth: float,
) -> Shell:  # fmt: skip
    """Return the shell over rows of points: triangles between the rows, normals, and cells.

    Args:
        rows: (n_i, 3) points of each row across the region.
        grid: (N, 2) place of each point, as in ``Shell``.
        size_of_cells: along the region and across it [m].
        across_m: (N,) metres in one unit of ``grid`` across the region.
        lean: how far a vertex's direction leans from its cell's normal (0) to its own (1).
    """
    vertices, triangles = np.concatenate(rows), zip_rows(rows)
    normals, area = normals_and_areas(vertices, triangles)
    if np.einsum("ij,ij->i", normals, vertices - axis_points).mean() < 0:
        triangles, normals = triangles[:, ::-1], -normals
    cell = cells_of(grid, pinned=pinned, area=area, size=size_of_cells, across_m=across_m)
    frames = frames_of(cell, normals=normals, area=area, along=frame[:, 0])
    outward = np.where(pinned[:, None], normals, (1 - lean) * frames[cell, :, 2] + lean * normals)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return Shell(
        vertices=vertices, normals=normals, triangles=triangles, pinned=pinned, fine=fine & ~pinned, area=area,
        cell=cell, cell_frames=frames, inward=-outward,
        axis_points=axis_points, grid=grid, frame_origin=origin, frame=frame,
        length_m=length, radius_m=radius, axis_depth_m=depth,
    )  # fmt: skip
