"""shear_dose: the friction force on the skin, integrated over time."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.cell_share import of_cells
from carecontact.scoring.touched_cells import TouchedCells


@of_cells("shear_dose", title="Shear dose", unit="N s", better="lower", order=61)
def shear_dose(cells: TouchedCells, contact: Contact) -> float:
    """Integral over time of the size of the friction force, summed over the target's cells. Shear that goes back and
    forth adds up, and so does shear in opposite directions on two cells. No limit of it was found in the literature."""
    return float(cells.shear_ns.sum())
