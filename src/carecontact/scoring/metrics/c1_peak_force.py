"""C1@1: peak contact force on the reported region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import METRICS, Metric


@dataclass(frozen=True, kw_only=True)
class PeakForce:
    """All [N]; the first is C1, the others stand beside it to show what the choice of force decides."""

    peak: float
    """Of the norm of the region's summed force over the contact window, unfiltered."""
    filtered: float
    """The same after a zero-phase low pass (100 Hz)."""
    contact_sum: float
    """Of the sum of per-contact normal magnitudes over the contact window."""
    any_segment: float
    """Of any segment's norm over the whole trial, contact window or not."""


def peak_force(contact: Contact) -> PeakForce | None:
    """None (NA) without valid contact."""
    if not contact.valid or contact.reported is None:
        return None
    normal = contact.recording["scorer/normal_force"][:, contact.reported]
    return PeakForce(
        peak=float(contact.force_in_window.max()),
        filtered=float(contact.filtered_force[contact.window].max()),
        contact_sum=float(normal[contact.window].max()),
        any_segment=float(contact.force_norm.max()),
    )


def peak_of_segments(contact: Contact) -> dict[str, float]:
    """Touched segment -> largest force norm of the whole trial [N].

    The safety gate reads this one and not the contact window, which the causal filter opens some steps late.
    """
    return {contact.segments[i]: float(np.max(contact.force_norm[:, i])) for i in contact.touched}


def _compute(contact: Contact) -> float | None:
    result = peak_force(contact)
    return None if result is None else result.peak


METRICS.register("C1@1", Metric(id="C1@1", title="Peak force", unit="N", better="lower", compute=_compute))
