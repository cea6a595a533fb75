"""Points in a region's frame and their distance from its surface."""

from __future__ import annotations

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.scoring.filters import F64


def points_in_region(points_in_world: F64, region_pose_in_world: F64) -> F64:
    """(N, 3) points, (N, 7) region poses -> (N, 3) coordinates: x along the bone, z outward [m]."""
    rotation = matrix_from_quat(region_pose_in_world[:, 3:])
    offset = points_in_world - region_pose_in_world[:, :3]
    return np.einsum("nij,ni->nj", rotation, offset)


def distance_to_surface(points: F64, size: F64) -> F64:
    """(N, 3) points in the region's frame -> (N,) signed distance from its surface [m], negative inside.

    ``size`` (3,) is length, half width (y) and outward radius (z). The region is taken as a straight elliptic
    cylinder about the x axis with the frame's origin at its middle. Distance is measured along the ray from the
    axis, exact for a round limb.
    """
    length, half_width, outward = (float(s) for s in size)
    along, across = np.abs(points[:, 0]) - length / 2, points[:, 1:]
    from_axis = np.linalg.norm(across, axis=1)
    relative = np.hypot(across[:, 0] / half_width, across[:, 1] / outward)
    # On the axis itself the ray has no direction; the nearest surface is the smaller radius away.
    on_axis = relative < 1e-9
    scale = np.where(on_axis, 1.0, relative)
    radial = np.where(on_axis, -min(half_width, outward), from_axis * (1.0 - 1.0 / scale))
    return np.where(along > 0, np.hypot(np.maximum(radial, 0.0), np.maximum(along, 0.0)), radial)


def surface_normal(points: F64, size: F64) -> F64:
    """(N, 3) points in the region's frame -> (N, 3) outward unit normal of the cylinder's side through each.

    A point on the axis itself gets the z axis.
    """
    _, half_width, outward = (float(s) for s in size)
    gradient = np.stack([np.zeros(len(points)), points[:, 1] / half_width**2, points[:, 2] / outward**2], axis=1)
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    on_axis = length < 1e-9
    return np.where(on_axis, [0.0, 0.0, 1.0], gradient / np.where(on_axis, 1.0, length))


def distance_to_shadow(points_in_world: F64, region_pose_in_world: F64, size: F64) -> F64:
    """(N, 3) points, (N, 7) region poses -> (N,) horizontal distance from the region's shadow on the floor [m], 0 over
    it or under it.

    The shadow is taken as a rectangle: as long as the axis looks from above, as wide as the region.
    """
    rotation = matrix_from_quat(region_pose_in_world[:, 3:])
    axis = rotation[:, :2, 0]
    length = np.linalg.norm(axis, axis=1)
    # An upright axis has no direction from above; any will do for a shadow of length 0.
    upright = length < 1e-9
    direction = np.where(upright[:, None], [1.0, 0.0], axis / np.where(upright, 1.0, length)[:, None])
    offset = (points_in_world - region_pose_in_world[:, :3])[:, :2]
    along = np.abs(np.einsum("ni,ni->n", offset, direction)) - length * float(size[0]) / 2
    across = np.abs(offset[:, 0] * direction[:, 1] - offset[:, 1] * direction[:, 0]) - float(size[1])
    return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
