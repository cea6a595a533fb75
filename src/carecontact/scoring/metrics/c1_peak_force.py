"""C1@1: peak contact force on the reported region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


@dataclass(frozen=True, kw_only=True)
class PeakForce:
    """Peaks [N]. The first is C1; the others show how much the choice of force decides."""

    c1_peak_force_n: float
    """Peak of the norm of the reported segment's summed force over the contact window, unfiltered."""
    c1_peak_filtered_n: float
    """The same after a zero-phase low pass (100 Hz)."""
    c1_peak_contact_sum_n: float
    """Peak of the sum of the magnitudes of each contact's normal force over the contact window."""
    c1_peak_any_segment_n: float
    """Peak of any segment's norm over the whole trial, inside the contact window or not."""


@metric(
    "C1@1", title="Peak force", unit="N", better="lower", field="c1_peak_force_n", digits=2, headline=True, matters=5.0,
    order=0,
)  # fmt: skip
def peak_force(contact: Contact) -> PeakForce | None:
    """Return the peaks of the force; None (NA) without valid contact."""
    if not contact.valid or contact.reported is None:
        return None
    normal = contact.recording["scorer/normal_force"][:, contact.reported]
    return PeakForce(
        c1_peak_force_n=float(contact.force_in_window.max()),
        c1_peak_filtered_n=float(contact.filtered_force[contact.window].max()),
        c1_peak_contact_sum_n=float(normal[contact.window].max()),
        c1_peak_any_segment_n=float(contact.force_norm.max()),
    )


def peak_of_segments(contact: Contact) -> dict[str, float]:
    """Return touched segment -> largest force norm of the whole trial [N].

    The safety gate reads this one and not the contact window, which the causal filter opens some steps late.
    """
    return {contact.segments[i]: float(np.max(contact.force_norm[:, i])) for i in contact.touched}
