"""Whether a policy's views showed the named region, according to the perception errors in the recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from carecontact.recording.perception import JOINTS, perception_errors
from carecontact.regions import REGIONS
from carecontact.scoring.contact import Contact

LOCATED = frozenset(("depth", "points", "masks", "landmarks"))
"""Modalities from which a place is computed; with fewer the key points or the mask must do."""
PERSON_IOU = 0.5


@dataclass(frozen=True, kw_only=True)
class Sight:
    """Counts of views: one camera in one observation, with key points or masks."""

    views: int = 0
    visible: int = 0
    """Number of views in which every joint at the region's ends was visible"""
    found: int = 0
    """Number of these views from whose modalities the region can be found"""
    error_m: float | None = None
    """Median horizontal error of the places that they led to; None where none was computed"""


def sight(contact: Contact, near_m: float) -> Sight:
    """``near_m``: horizontal error up to which a computed place counts as the region.

    No view counts where the region's row names no joints by which it could be found. Raises RecordingError for
    malformed ``perception/*``.
    """
    rows, region = perception_errors(contact.recording), contact.task.region
    names = REGIONS[region].sight_joints
    if rows is None or not len(rows.camera) or not names:
        return Sight()
    joints = [list(JOINTS).index(name) for name in names]
    visible = rows.joint_visible[:, joints].all(axis=1)
    column = contact.recording.header.regions.index(region)
    error = np.linalg.norm(rows.target_error_m[:, column, :2].astype(np.float64), axis=1)
    if set(modalities(contact)) >= LOCATED:
        found = error <= near_m
    else:
        found = np.isfinite(rows.landmark_error_px[:, joints]).all(axis=1) | (rows.human_iou >= PERSON_IOU)
    computed = error[np.isfinite(error) & visible]
    return Sight(
        views=len(rows.camera),
        visible=int(visible.sum()),
        found=int((visible & found).sum()),
        error_m=float(np.median(computed)) if len(computed) else None,
    )


def modalities(contact: Contact) -> list[str]:
    """Return the modalities that the policy's card requests; empty if the policy never sent a card."""
    named = (contact.recording.header.card or {}).get("modalities")
    return [m for m in cast("list[Any]", named) if isinstance(m, str)] if isinstance(named, list) else []
