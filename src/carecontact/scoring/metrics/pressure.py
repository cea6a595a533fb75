"""Pressure on the skin of the target region: mean, peak, how long it was uncomfortable, and how near to pain.

Every metric here speaks of the region's cells alone. Version 1 has a value wherever a cell was touched, even where the
cells felt next to nothing of the contact. Version 2 is NA there: it needs cells that felt most of the force.
"""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.limits import LIMIT_PACKS, UNCHECKED
from carecontact.scoring.metrics.cell_share import of_cells
from carecontact.scoring.touched_cells import MMHG_PA, TouchedCells

COMFORT_MMHG = 25.0
"""Upper end of the ordinary wiping of nurses, at which 31 % of 30 adults felt slight pain: Konya et al. 2020 (Japan
Journal of Nursing Science; only its abstract was read)."""
FRAGILE_MMHG = 14.0
"""Upper end of weak wiping in the same study, at which 11 % felt slight pain, people with sensitive skin among them."""
MOST_OF_TIME = 0.95
"""Share of the time in contact; assumed. The studies give the pressure of whole wipes, so a single moment is not
compared with them, but neither may a hard stroke hide in the mean of a trial."""
PAIN_PACK = "iso-ts-15066-2016-pressure"


@of_cells("pressure_mean", title="Mean pressure in contact", unit="kPa", better="neither", order=14)
def mean_pressure(cells: TouchedCells, contact: Contact) -> float:
    """Normal force over area in contact, over all of the contact of the target's cells."""
    return cells.mean_pressure_pa / 1000


@of_cells("pressure_peak", title="Peak pressure", unit="kPa", better="lower", order=15)
def peak_pressure(cells: TouchedCells, contact: Contact) -> float:
    """Largest ``TouchedCells.pressure_pa`` of a cell and a control period."""
    return float(cells.pressure_pa.max()) / 1000


@of_cells("exposure_uncomfortable", title=f"Time above {COMFORT_MMHG:g} mmHg", unit="s", better="lower", order=33)
def uncomfortable(cells: TouchedCells, contact: Contact) -> float:
    """Time in which a cell of the target bears more than COMFORT_MMHG."""
    return cells.time_above(COMFORT_MMHG * MMHG_PA)


@of_cells(
    "exposure_fragile", title=f"Time above {FRAGILE_MMHG:g} mmHg (fragile skin)", unit="s", better="lower", order=34
)
def fragile(cells: TouchedCells, contact: Contact) -> float:
    """Time in which a cell of the target bears more than FRAGILE_MMHG."""
    return cells.time_above(FRAGILE_MMHG * MMHG_PA)


@of_cells("comfortable", title=f"Wiped below {COMFORT_MMHG:g} mmHg", better="higher", answer=True, order=35)
def comfortable(cells: TouchedCells, contact: Contact) -> float:
    """1 where the pressure under the tool stays at or below COMFORT_MMHG for MOST_OF_TIME of its time in contact, else
    0."""
    return _stays_below(cells, COMFORT_MMHG)


@of_cells(
    "comfortable_fragile",
    title=f"Wiped below {FRAGILE_MMHG:g} mmHg (fragile skin)",
    better="higher",
    answer=True,
    order=36,
)
def comfortable_fragile(cells: TouchedCells, contact: Contact) -> float:
    """Return the same with FRAGILE_MMHG."""
    return _stays_below(cells, FRAGILE_MMHG)


@of_cells(
    "pressure_utilisation",
    title=f"Peak pressure relative to the ISO/TS 15066 pressure limit{UNCHECKED}",
    better="lower",
    order=51,
)
def pressure_utilisation(cells: TouchedCells, contact: Contact) -> float:
    """``pressure_peak`` as a share of what pack iso-ts-15066-2016-pressure allows the target's segment."""
    return float(cells.pressure_pa.max()) / LIMIT_PACKS[PAIN_PACK].limit(contact.segments[contact.target])


def _stays_below(cells: TouchedCells, mmhg: float) -> float:
    """Return what a sensor on the whole tool would say: force over area in contact, in each control period."""
    return float(cells.share_of_time_below(mmhg * MMHG_PA) >= MOST_OF_TIME)
