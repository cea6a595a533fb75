"""C5@1: how much the contact force fluctuates."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


@metric(
    "C5@1", title="Force stability", unit="N", better="lower", field="c5_force_sd_n", digits=2, headline=True,
    matters=1.0, order=0,
)  # fmt: skip
def force_stability(contact: Contact) -> float | None:
    """Population standard deviation of the reported region's force norm over the contact window [N], unfiltered.

    None (NA) without valid contact.
    """
    return float(contact.force_in_window.std()) if contact.valid else None
