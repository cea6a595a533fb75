"""impulse@1: the impulse of all contact forces on the person."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


def total_impulse(contact: Contact) -> float:
    """Integral of each segment's force norm over its on-samples, summed over segments [N s]; 0 without contact."""
    return float(contact.impulse_ns.sum())


@metric("impulse@1", title="Impulse", unit="N s", better="neither", order=10)
def impulse(contact: Contact) -> float | None:
    """``total_impulse`` [N s]; None (NA) without valid contact."""
    return total_impulse(contact) if contact.valid else None
