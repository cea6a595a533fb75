"""The person in one camera's view: centres of joints from key points, and points of the surface from a mask."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.contract.observation import CameraView
from carecontact.errors import ContractError

F64 = npt.NDArray[np.float64]

LANDMARK = {
    "left shoulder": 11,
    "right shoulder": 12,
    "left elbow": 13,
    "right elbow": 14,
    "left wrist": 15,
    "right wrist": 16,
    "left hip": 23,
    "right hip": 24,
    "left knee": 25,
    "right knee": 26,
    "left ankle": 27,
    "right ankle": 28,
}
"""Index of each key point in the order of MediaPipe Pose."""
JOINT_DEPTH_M = {"shoulder": 0.045, "elbow": 0.040, "wrist": 0.025, "hip": 0.090, "knee": 0.065, "ankle": 0.050}
"""Depth of a joint's centre behind the skin in front of it, along the line of sight; for adults, rounded, assumed. The
knee's is that of the shipped bodies from the front, 63 to 83 mm; the ankle's is half of the foot's joint from front to
heel. No shipped region uses these two."""
MIN_VISIBILITY = 0.5
"""Key points that the estimator rates lower count as hidden."""


class PerceptionFailure(ContractError):
    """A region cannot be found in an observation; the message gives the reason."""


def person_points(view: CameraView) -> F64:
    """Return the (N, 3) points of the person's surface in base [m]; the view must hold depth, points and masks."""
    return points_of(view, "human")


def points_of(view: CameraView, name: str) -> F64:
    """Return the (N, 3) points of the mask ``name`` in base [m]; the view must hold depth, points and masks."""
    # A view's ``points`` are its pixels with a depth, row by row.
    assert view.points is not None
    assert view.depth is not None
    assert view.masks is not None
    return view.points[view.masks[name][np.isfinite(view.depth)]].astype(np.float64)


def joint_centre(view: CameraView, name: str) -> F64:
    """Return a joint's (3,) centre in base [m]: the surface under the key point, moved on along the line of sight.

    Raises:
        PerceptionFailure: no key point has this name, nobody was found, or the key point is hidden or has no depth.
    """
    assert view.landmarks is not None
    if name not in LANDMARK:
        raise PerceptionFailure(f"no key point is named {name!r}; valid: {', '.join(LANDMARK)}")
    index = LANDMARK[name]
    visibility = float(view.landmarks[index, 2])
    if not np.isfinite(visibility):
        raise PerceptionFailure("nobody was found in the image")
    if visibility < MIN_VISIBILITY:
        raise PerceptionFailure(f"{name} is hidden (visibility {visibility:.2f} < {MIN_VISIBILITY})")
    surface = np.full(3, np.nan) if view.landmarks_in_base is None else view.landmarks_in_base[index].astype(np.float64)
    if not np.isfinite(surface).all():
        raise PerceptionFailure(f"{name} has no depth")
    sight = surface - view.pose_camera_in_base[:3, 3]
    return surface + JOINT_DEPTH_M[name.split()[1]] * sight / np.linalg.norm(sight)
