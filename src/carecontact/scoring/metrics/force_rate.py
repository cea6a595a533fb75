"""force_rate_p95@1: how abruptly the contact force changes."""

from __future__ import annotations

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


@metric("force_rate_p95@1", title="Force rate, 95th percentile", unit="N/s", better="lower", order=20)
def force_rate_p95(contact: Contact) -> float | None:
    """95th percentile of |dF/dt| of the reported region's force norm [N/s].

    First differences between neighbouring steps that both lie in the contact window, after the zero-phase low pass of
    the filtered peak (100 Hz): a difference over one physics step would measure the contact solver's jitter.
    None (NA) without valid contact or without two neighbouring steps.
    """
    if not contact.valid:
        return None
    both = contact.window[1:] & contact.window[:-1]
    rate = np.abs(np.diff(contact.filtered_force)[both]) / contact.dt_s
    return float(np.percentile(rate, 95)) if len(rate) else None
