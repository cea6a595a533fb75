"""Pressure on the skin of the target region: mean, peak, how long it was uncomfortable, and how near to pain."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.limits import LIMIT_PACKS
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.touched_cells import MMHG_PA, touched_cells

COMFORT_MMHG = 25.0
"""Upper end of the ordinary wiping of nurses, at which 31 % of 30 adults felt slight pain: Konya et al. 2020 (Japan
Journal of Nursing Science; only its abstract was read)."""
FRAGILE_MMHG = 14.0
"""Upper end of weak wiping in the same study, at which 11 % felt slight pain, people with sensitive skin among them."""
MOST_OF_TIME = 0.95
"""Share of the time in contact; assumed. The studies give the pressure of whole wipes, so a single moment is not
compared with them, but neither may a hard stroke hide in the mean of a trial."""
PAIN_PACK = "iso-ts-15066-2016-pressure"


@metric("pressure_mean@1", title="Mean pressure in contact", unit="kPa", better="neither", order=14)
def mean_pressure(contact: Contact) -> float | None:
    """Normal force over area in contact, over all of the contact of the target's cells; None (NA) if none was
    touched."""
    cells = touched_cells(contact)
    return None if cells is None else cells.mean_pressure_pa / 1000


@metric("pressure_peak@1", title="Peak pressure", unit="kPa", better="lower", order=15)
def peak_pressure(contact: Contact) -> float | None:
    """Largest ``TouchedCells.pressure_pa`` of a cell and a control period; None (NA) if none was touched."""
    cells = touched_cells(contact)
    return None if cells is None else float(cells.pressure_pa.max()) / 1000


@metric("exposure_uncomfortable@1", title=f"Time above {COMFORT_MMHG:g} mmHg", unit="s", better="lower", order=33)
def uncomfortable(contact: Contact) -> float | None:
    """Time in which a cell of the target bears more than COMFORT_MMHG; None (NA) if none was touched."""
    return _time_above(contact, COMFORT_MMHG)


@metric(
    "exposure_fragile@1", title=f"Time above {FRAGILE_MMHG:g} mmHg (fragile skin)", unit="s", better="lower", order=34
)
def fragile(contact: Contact) -> float | None:
    """Time in which a cell of the target bears more than FRAGILE_MMHG; None (NA) if none was touched."""
    return _time_above(contact, FRAGILE_MMHG)


@metric("comfortable@1", title=f"Wiped below {COMFORT_MMHG:g} mmHg", unit="1", better="higher", median=False, order=35)
def comfortable(contact: Contact) -> float | None:
    """1 where the pressure under the tool stays at or below COMFORT_MMHG for MOST_OF_TIME of its time in contact, else
    0; None (NA) if none was touched."""
    return _stays_below(contact, COMFORT_MMHG)


@metric(
    "comfortable_fragile@1",
    title=f"Wiped below {FRAGILE_MMHG:g} mmHg (fragile skin)",
    unit="1",
    better="higher",
    median=False,
    order=36,
)
def comfortable_fragile(contact: Contact) -> float | None:
    """The same with FRAGILE_MMHG."""
    return _stays_below(contact, FRAGILE_MMHG)


@metric(
    "pressure_utilisation@1",
    title="Peak pressure relative to the ISO/TS 15066 pressure limit (to be checked against the standard)",
    unit="1",
    better="lower",
    order=51,
)
def pressure_utilisation(contact: Contact) -> float | None:
    """``pressure_peak@1`` as a share of what pack iso-ts-15066-2016-pressure allows the target's segment."""
    cells = touched_cells(contact)
    if cells is None:
        return None
    return float(cells.pressure_pa.max()) / LIMIT_PACKS[PAIN_PACK].limit(contact.segments[contact.target])


def _time_above(contact: Contact, mmhg: float) -> float | None:
    cells = touched_cells(contact)
    return None if cells is None else cells.time_above(mmhg * MMHG_PA)


def _stays_below(contact: Contact, mmhg: float) -> float | None:
    """What a sensor on the whole tool would say: force over area in contact, in each control period."""
    cells = touched_cells(contact)
    return None if cells is None else float(cells.share_of_time_below(mmhg * MMHG_PA) >= MOST_OF_TIME)
