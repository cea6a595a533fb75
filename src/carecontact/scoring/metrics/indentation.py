"""beyond_calibrated@1: the share of the contact that is deeper than the measurements to which the tissue was fitted."""

from __future__ import annotations

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.filters import F64
from carecontact.scoring.metrics.metric import metric


def deepest_indentation(contact: Contact) -> float:
    """Return the deepest indentation of the target region in the whole trial [m]; 0 if nothing was recorded."""
    return float(_depth(contact).max(initial=0.0))


@metric(
    "beyond_calibrated@1",
    title="Share of contact time beyond the measured indentation",
    unit="1",
    better="neither",
    order=70,
)
def beyond_calibrated(contact: Contact) -> float | None:
    """Share of the control periods with the target touched in which it was pressed deeper than its tissue was measured.

    None (NA) if no control period has it touched, and on a rigid region.
    """
    depth = _depth(contact)
    if len(depth) == 0 or len(contact.time_s) == 0:
        return None
    step = np.searchsorted(contact.time_s, contact.recording["scorer/period_time_s"] - contact.dt_s / 2)
    touched = contact.on[np.minimum(step, len(contact.time_s) - 1), contact.target]
    tissue = contact.protocol.person.tissue.get(contact.task.region)
    return None if tissue is None or not touched.any() else float((depth[touched] > tissue.measured_depth_m).mean())


def _depth(contact: Contact) -> F64:
    """(P,) largest inward anchor displacement of the target region [m]; 0 on a rigid one"""
    region = contact.recording.header.regions.index(contact.task.region)
    return contact.recording["scorer/indentation_m"][:, region].astype(np.float64)
