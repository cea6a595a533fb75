"""shear_work@1: the work that friction does on the skin."""

from __future__ import annotations

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.regions import REGIONS
from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.region import surface_normal


@metric("shear_work@1", title="Shear work", unit="J", better="neither", order=60)
def shear_work(contact: Contact) -> float | None:
    """Tangential contact force on the reported region times tangential slip of the tool point over it [J], net.

    Both in the bone's frame, so that carrying the arm is not slip; tangential to the region's elliptic surface at the
    tool. The force of a step times the travel to the next, where both steps lie in the contact window. Stretching the
    tissue back and forth cancels; what stays is what friction dissipated. None (NA) without valid contact and where
    the reported segment has no region, because no frame of it is recorded.
    """
    recording = contact.recording
    if not contact.valid or contact.reported is None:
        return None
    names, segment = recording.header.regions, contact.segments[contact.reported]
    region = next((k for k, name in enumerate(names) if name in REGIONS and REGIONS[name].segment == segment), None)
    if region is None:
        return None
    joined = contact.window[1:] & contact.window[:-1]
    both = np.flatnonzero(joined)
    step = np.flatnonzero(np.concatenate([joined, [False]]) | np.concatenate([[False], joined]))
    pose = recording["scorer/region_pose_in_world"][step, region].astype(np.float64)
    to_region = matrix_from_quat(pose[:, 3:])
    offset = recording["scorer/pose_tcp_in_world"][step, :3].astype(np.float64) - pose[:, :3]
    point = np.einsum("nij,ni->nj", to_region, offset)
    force_in_world = recording["scorer/force_human_from_robot_in_world"][step, contact.reported].astype(np.float64)
    force = np.einsum("nij,ni->nj", to_region, force_in_world)
    normal = surface_normal(point, recording["scorer/region_size_m"][region])
    tangential = force - (force * normal).sum(axis=1, keepdims=True) * normal

    here = np.searchsorted(step, both)
    travel = point[here + 1] - point[here]  # of which the tangential force sees the tangential part
    return float((tangential[here] * travel).sum())
