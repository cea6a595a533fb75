"""The lying pose: where each hinge starts before the person settles."""

from __future__ import annotations

import numpy as np

from carecontact.world.human.body import Array
from carecontact.world.human.joints import Hinge

# Columns are the mesh frame's axes in the world: mesh z (head) -> +x, mesh -y (front) -> +z, mesh x (left) -> -y.
SUPINE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


# Segments welded in the lying pose, declared: no task moves them, and their hinges cost time in every step. Trunk and
# legs still lie on the bed by contact, so that the bed carries the person's weight and every press.
FIXED_SEGMENTS = frozenset(
    ["abdomen", "thorax", *(f"{s}_{n}" for s in ("left", "right") for n in ("clavicle", "thigh", "shank", "foot"))]
)


def lying_pose_deg(comfort_arm_deg: float) -> dict[str, float]:
    """Hinge -> anatomical angle [deg]; hinges not named keep the bind pose.

    The right arm lies palm up on its board, slightly bent; the heels rest on the mattress.
    """
    return {
        "right_upper_arm_abduction": comfort_arm_deg, "right_upper_arm_flexion": -12.0, "right_upper_arm_rotation": 0.0,
        "right_forearm_flexion": 12.0, "right_forearm_supination": 58.0, "right_hand_flexion": 0.0,
        "left_upper_arm_abduction": 22.0, "left_upper_arm_flexion": -17.0, "left_upper_arm_rotation": 10.0,
        "left_forearm_flexion": 14.0, "left_forearm_supination": 45.0,
        **{f"{s}_thigh_flexion": 1.8 for s in ("left", "right")},
        **{f"{s}_thigh_abduction": 3.0 for s in ("left", "right")},
        **{f"{s}_foot_plantarflexion": 18.0 for s in ("left", "right")},
    }  # fmt: skip


def rotation_from_bind(rows: list[Hinge], segment: str, pose_deg: dict[str, float]) -> Array:
    """(3, 3) turn of a segment against its parent when its hinges stand at the pose's angles."""
    out = np.eye(3)
    for row in rows:
        if row.segment == segment and row.name in pose_deg:
            out = out @ axis_rotation(row.axis, np.radians(pose_deg[row.name] - row.bind_deg))
    return out


def axis_rotation(axis: Array, angle: float) -> Array:
    """(3, 3) by Rodrigues' formula."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
