"""The shell of a soft region, and how it is made from rows of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.world.human.body import Array
from carecontact.world.human.surface_mesh import normals_and_areas, zip_rows

GROWTH = 0.4
"""Increase of the spacing [m] for each metre of distance from the fine patch."""
ROW_RATIO = np.sqrt(3) / 2
"""Distance between the rows of a triangular lattice, as a share of the distance between points in a row."""
SMOOTHING_M = 0.012
"""Standard deviation of the smoothing of the sampled surface. The body's own faces are 20 mm wide, and without
smoothing their edges made the force of a press vary by 9 to 16 % from place to place."""


@dataclass(frozen=True, kw_only=True)
class Shell:
    """A surface of triangles, with vertices in rows across the region's axis."""

    vertices: Array
    """(N, 3) mesh frame"""
    normals: Array
    """(N, 3) outward unit"""
    triangles: npt.NDArray[np.int64]
    """(M, 3) wound outward"""
    fine: npt.NDArray[np.bool_]
    """(N,) on the patch that the tool reaches"""
    area: Array
    """(N,) share of the surface [m^2]"""
    axis_points: Array
    """(N, 3) point of the region's axis (abdomen: of its back plane) inward of each vertex"""
    grid: Array
    """(N, 2) place along the axis from the shell's start [m], and across: angle round a limb [rad], on a trunk [m]"""
    frame_origin: Array
    frame: Array
    """(3, 3) columns x (along), y, z (outward at the middle): the region frame in the mesh frame"""
    length_m: float
    radius_m: float
    axis_depth_m: float
    """Depth of the axis under the surface at the middle."""


def spacing(tissue: Tissue, distance: Array) -> Array:
    """Return the (n,) distance between neighbouring vertices [m] at (n,) distances outside the fine patch [m]."""
    return np.clip(tissue.spacing_m + GROWTH * distance, None, tissue.coarse_spacing_m)


def finish(
    rows: list[Array], grid: Array, *, fine: npt.NDArray[np.bool_], axis_points: Array, origin: Array, frame: Array,
    length: float, radius: float, depth: float,
) -> Shell:  # fmt: skip
    """Return the shell over rows of points: triangles between the rows, normals and areas.

    Args:
        rows: (n_i, 3) points of each row across the region.
        grid: (N, 2) place of each point, as in ``Shell``.
    """
    vertices, triangles = np.concatenate(rows), zip_rows(rows)
    normals, area = normals_and_areas(vertices, triangles)
    if np.einsum("ij,ij->i", normals, vertices - axis_points).mean() < 0:
        triangles, normals = triangles[:, ::-1], -normals
    return Shell(
        vertices=vertices, normals=normals, triangles=triangles, fine=fine, area=area, axis_points=axis_points,
        grid=grid, frame_origin=origin, frame=frame, length_m=length, radius_m=radius, axis_depth_m=depth,
    )  # fmt: skip
