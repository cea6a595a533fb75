"""gentle_hold@2, axis_passed@2, gentle_share@2, wrist_from_onset@2: the quantities that the
exam's gates limit, for trials under any gates.

The bands are those of the exam; their reasons are in docs/scoring.md.
"""

from __future__ import annotations

from carecontact.scoring.axis_passes import wiping
from carecontact.scoring.contact import Contact, longest_run
from carecontact.scoring.held_force import held_in_band
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.progress import wrist_from_onset

LEAST_N = 1.0
TOUCH_MOST_N = 6.0
SCRUB_MOST_N = 8.0
PASSES = 3


@metric("gentle_hold@2", title="Longest gentle hold", unit="s", better="higher", pool=("touch",), order=70)
def gentle_hold(contact: Contact) -> float | None:
    """Longest stretch in contact with a held force of LEAST_N to TOUCH_MOST_N; None (NA) without valid contact."""
    return longest_run(held_in_band(contact, LEAST_N, TOUCH_MOST_N)) * contact.dt_s if contact.valid else None


@metric("axis_passed@2", title="Length passed three times", unit="m", better="higher", pool=("scrub",), order=71)
def axis_passed(contact: Contact) -> float | None:
    """Length of the region's axis that the tool passed PASSES times with at least LEAST_N [m]; None (NA) without valid
    contact."""
    return wiping(contact).passed_m(PASSES, LEAST_N) if contact.valid else None


@metric("gentle_share@2", title="Share of gentle wiping", unit="1", better="higher", pool=("scrub",), order=72)
def gentle_share(contact: Contact) -> float | None:
    """Share of the time of sliding with a held force of LEAST_N to SCRUB_MOST_N; None (NA) without valid contact, and
    where the tool never slid."""
    return wiping(contact).share_in_band(LEAST_N, SCRUB_MOST_N) if contact.valid else None


@metric("wrist_from_onset@2", title="Wrist moved since contact", unit="m", better="neither", pool="moving", order=73)
def moved_since_contact(contact: Contact) -> float | None:
    """Largest horizontal displacement of the wrist within one contact, from its start [m]; None (NA) without
    valid contact."""
    return wrist_from_onset(contact) if contact.valid else None
