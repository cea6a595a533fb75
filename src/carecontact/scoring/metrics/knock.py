"""knock_impulse@1, knock_energy@1: how hard the tool lands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.scoring.contact import Contact, runs
from carecontact.scoring.filters import F64
from carecontact.scoring.metrics.metric import metric

KNOCK_S = 0.1
"""[s] How much of a contact counts as its beginning; assumed. A blow of an arm on soft tissue lasts about 0.1 s, and
pressing on purpose takes longer to build up."""


def knocks(contact: Contact) -> Iterator[tuple[int, slice]]:
    """Segment and first KNOCK_S of each touch, from the first force and not from where the filtered force counts."""
    length = round(KNOCK_S / contact.dt_s)
    for segment in contact.touched:
        for start, stop in runs(contact.force_norm[:, segment] > 0).tolist():
            if contact.on[start:stop, segment].any():
                yield segment, slice(start, min(stop, start + length))


@metric("knock_impulse@1", title="Impulse of the hardest knock", unit="N s", better="lower", order=16)
def knock_impulse(contact: Contact) -> float | None:
    """Largest integral of F_b over the first KNOCK_S of a touch of any segment [N s]; None (NA) if nothing was
    touched."""
    found = [float(contact.force_norm[time, segment].sum()) * contact.dt_s for segment, time in knocks(contact)]
    return max(found, default=None)


@metric("knock_energy@1", title="Energy of the hardest knock", unit="J", better="lower", order=17)
def knock_energy(contact: Contact) -> float | None:
    """Largest work of the tool on a segment over the first KNOCK_S of a touch, up to its peak [J]; None (NA) if nothing
    was touched.

    The force times the velocity of the tool at the contact's centre. Where another link than the hand touches, this is
    the velocity that the hand would have there.
    """
    found = [_work(contact, segment, time) for segment, time in knocks(contact)]
    return max(found, default=None)


def _work(contact: Contact, segment: int, time: slice) -> float:
    recording = contact.recording
    pose = recording["scorer/pose_tcp_in_world"][time].astype(np.float64)
    force = recording["scorer/force_human_from_robot_in_world"][time, segment].astype(np.float64)
    centre = recording["scorer/centroid_in_world"][time, segment].astype(np.float64)
    if len(pose) < 2:
        return 0.0
    travel = _moved(pose, centre)
    done = np.cumsum(((force[1:] + force[:-1]) / 2 * travel).sum(axis=1))
    return max(0.0, float(done.max()))


def _moved(pose: F64, point: F64) -> F64:
    """(T - 1, 3) way from each step to the next of the tool's point that lies at ``point`` (T, 3) between them."""
    middle = (point[1:] + point[:-1]) / 2
    turn = matrix_from_quat(pose[:, 3:])
    # The point, in the tool's frame at the earlier step, is carried to the later one.
    local = np.einsum("tji,tj->ti", turn[:-1], middle - pose[:-1, :3])
    return pose[1:, :3] + np.einsum("tij,tj->ti", turn[1:], local) - middle
