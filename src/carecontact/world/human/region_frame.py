"""Place and size of a region on a body: the frame in which a tool's path over the region is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.regions import REGIONS
from carecontact.world.human.body import CHILD_ALONG, Array, Body
from carecontact.world.human.joints import hinges
from carecontact.world.human.pose import (
    MIDDLE_ARM_DEG,
    NOT_TURNED,
    ArmTurn,
    lying_pose_deg,
    segment_pose,
    trunk_rotation,
)
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import rigid_points

MIDDLE_SHARE = 0.1
"""Share of a rigid region's length, either way from its middle, in which its radii are measured."""
TRUNK_AXIS, FOOT_AXIS = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
"""Axes, in the mesh frame, of segments that have no next joint: toward the head, and from heel to toe."""


@dataclass(frozen=True, kw_only=True)
class RegionFrame:
    """A region's frame and size, in the mesh frame of the bind pose."""

    origin: Array
    """(3,) middle of the region's axis [m]"""
    axes: Array
    """(3, 3) columns x along the axis, y, z outward, which is up in the lying pose"""
    size_m: Array
    """(3,) length along x, mean radius (abdomen: half width), radius along z at the middle"""


def soft_frame(shell: Shell) -> RegionFrame:
    """Return the frame of a region with a shell."""
    return RegionFrame(
        origin=shell.frame_origin, axes=shell.frame,
        size_m=np.array([shell.length_m, shell.radius_m, shell.axis_depth_m]),
    )  # fmt: skip


def rigid_frame(body: Body, region: str, turn: ArmTurn = NOT_TURNED) -> RegionFrame:
    """Return the frame of a region without a shell: the whole segment, measured on its rigid surface.

    Raises SceneError for a segment without a surface.
    """
    segment = REGIONS[region].segment
    x = _axis(body, segment)
    outward = upward_in_bind(body, segment, turn)
    z = outward - (outward @ x) * x
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    points = rigid_points(body, segment) - body.joint_centre[segment]
    along = points @ x
    low, high = along.min(), along.max()
    near = points[np.abs(along - (low + high) / 2) <= MIDDLE_SHARE * (high - low)]
    width, height = near @ y, near @ z
    # The axis runs through the middle of the section, not through the joint.
    centre = (low + high) / 2 * x + (width.min() + width.max()) / 2 * y + (height.min() + height.max()) / 2 * z
    return RegionFrame(
        origin=body.joint_centre[segment] + centre, axes=np.stack([x, y, z], 1),
        size_m=np.array([high - low, np.ptp(width) / 2, np.ptp(height) / 2]),
    )  # fmt: skip


def upward_in_bind(body: Body, segment: str, turn: ArmTurn = NOT_TURNED) -> Array:
    """Return the direction (3,) in the segment's bind frame that points up in the nominal lying pose, with the comfort
    arm at the middle of its range.
    """
    rows, pose = hinges(body), lying_pose_deg(body, MIDDLE_ARM_DEG, turn)
    rotation, _ = segment_pose(body, rows, pose, trunk_rotation(body), segment)
    return rotation.T @ np.array([0.0, 0.0, 1.0])


def _axis(body: Body, segment: str) -> Array:
    kind = segment.partition("_")[2]
    if kind in CHILD_ALONG or kind == "hand":
        return body.direction(segment)
    return FOOT_AXIS if kind == "foot" else TRUNK_AXIS
