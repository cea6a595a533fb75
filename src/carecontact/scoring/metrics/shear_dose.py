"""shear_dose@1: the friction force on the skin, integrated over time."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.touched_cells import touched_cells


@metric("shear_dose@1", title="Shear dose", unit="N s", better="lower", order=61)
def shear_dose(contact: Contact) -> float | None:
    """Integral over time of the size of the friction force, summed over the target's cells; None (NA) if none was
    touched. Shear that goes back and forth adds up, and so does shear in opposite directions on two cells. No limit of
    it was found in the literature."""
    cells = touched_cells(contact)
    return None if cells is None else float(cells.shear_ns.sum())
