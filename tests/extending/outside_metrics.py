"""The mean force of the touch."""

from carecontact.scoring import metric
from carecontact.scoring.contact import Contact


@metric("mean_force@1", title="Mean force of the touch", unit="N", better="lower", digits=3)
def mean_force(contact: Contact) -> float | None:
    return float(contact.force_in_window.mean()) if contact.valid else None
