"""beyond_calibrated@2: the share of the contact that is deeper than the tissue is valid."""

from __future__ import annotations

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.filters import F64
from carecontact.scoring.metrics.metric import metric

GLIDE_M, MOVES_M_S = 0.015, 0.005
"""Depth beyond which the simulated skin is not valid under a moving tool, and speed from which on a tool moves: with 6
to 8 N, a slow cap that dents the abdomen by more is buried, sticks and slips, and its force drops by 1 to 13 N within
60 ms (docs/kernel.md, "Slow and deep"). Shallower glides do not."""


def deepest_indentation(contact: Contact) -> float:
    """Return the deepest indentation of the target region in the whole trial [m]; 0 if nothing was recorded."""
    return float(_depth(contact).max(initial=0.0))


@metric(
    "beyond_calibrated@2",
    title="Share of contact time deeper than the tissue is valid",
    unit="1",
    better="neither",
    order=70,
)
def beyond_calibrated(contact: Contact) -> float | None:
    """Share of the control periods with the target touched in which it was pressed deeper than its tissue was measured,
    or deeper than GLIDE_M by a tool that moved.

    None (NA) if no control period has it touched, and on a rigid region.
    """
    depth = _depth(contact)
    if len(depth) == 0 or len(contact.time_s) == 0:
        return None
    step = np.searchsorted(contact.time_s, contact.recording["scorer/period_time_s"] - contact.dt_s / 2)
    step = np.minimum(step, len(contact.time_s) - 1)
    touched = contact.on[step, contact.target]
    tissue = contact.protocol.person.tissue.get(contact.task.region)
    if tissue is None or not touched.any():
        return None
    moves = contact.recording["scorer/tcp_speed"][step] > MOVES_M_S
    return float(((depth > tissue.measured_depth_m) | (moves & (depth > GLIDE_M)))[touched].mean())


def _depth(contact: Contact) -> F64:
    """(P,) largest inward anchor displacement of the target region [m]; 0 on a rigid one"""
    region = contact.recording.header.regions.index(contact.task.region)
    return contact.recording["scorer/indentation_m"][:, region].astype(np.float64)
