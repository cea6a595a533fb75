"""Metrics of foam: how much of it was wiped away, and how much of the contact was where it lies."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.foam import cleaned_share, place_share
from carecontact.scoring.metrics.metric import metric

WITHIN_M = 0.030
"""Distance along the skin within which contact counts as at the foam, whatever the protocol's gate says [m]."""


@metric("foam_cleaned@1", title="Share of the foam cleaned", unit="1", better="higher", only=("scrub",), order=75)
def foam_cleaned(contact: Contact) -> float | None:
    """Share of the foam's area that the tool passed three times with a mean pressure of at least 10 mmHg; None (NA)
    where there was no foam."""
    return cleaned_share(contact)


@metric("foam_place@1", title="Share of the contact at the foam", unit="1", better="higher", only=("touch",), order=76)
def foam_place(contact: Contact) -> float | None:
    """Share of the contact impulse that the tool gave with its middle within WITHIN_M of the foam's; None (NA) where
    there was no foam or no contact."""
    return place_share(contact, WITHIN_M)
