"""pain_utilisation@1 and iso_utilisation@1: the hardest moment as a share of a published limit."""

from __future__ import annotations

from collections.abc import Callable

from carecontact.scoring.contact import Contact
from carecontact.scoring.limits import LIMIT_PACKS, UNCHECKED
from carecontact.scoring.metrics.c1_peak_force import peak_of_segments
from carecontact.scoring.metrics.metric import metric

ISO_PACK = "iso-ts-15066-2016"


def utilisation(contact: Contact, limit_n: Callable[[str], float]) -> float | None:
    """Largest ratio of a touched segment's peak force to its limit; None (NA) if nothing was touched.

    ``limit_n``: segment -> limit [N]. Reads the whole trial, and a contact too brief to be valid too: a knock counts.
    """
    return max((peak / limit_n(segment) for segment, peak in peak_of_segments(contact).items()), default=None)


@metric("pain_utilisation@1", title="Peak force relative to the pain limit", unit="1", better="lower", order=40)
def pain_utilisation(contact: Contact) -> float | None:
    """Return the largest share of the protocol's F_pain that a touched segment bore."""
    return utilisation(contact, contact.protocol.f_pain)


@metric(
    "iso_utilisation@1",
    title=f"Peak force relative to the ISO/TS 15066 force limit{UNCHECKED}",
    unit="1",
    better="lower",
    order=50,
)
def iso_utilisation(contact: Contact) -> float | None:
    """Return the largest share of the force limits of ISO/TS 15066:2016 that a touched segment bore."""
    return utilisation(contact, LIMIT_PACKS[ISO_PACK].limit)
