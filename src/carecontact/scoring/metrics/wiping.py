"""coverage@1, effective_wiping@1, effective@1: how much of the region was wiped, and how much of it well enough to be
clean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.touched_cells import MMHG_PA, TouchedCells, touched_cells

CLEANS: Sequence[tuple[int, float]] = ((3, 10 * MMHG_PA), (2, 40 * MMHG_PA), (1, 50 * MMHG_PA))
"""(passes, least mean pressure [Pa]) after which at least 80 % of oily dirt was gone from the forearms of 50 adults:
Konya et al., "Combination of minimum wiping pressure and number of wipings that can remove pseudo skin dirt" (only its
abstract was read). Konya et al. 2023 (BMC Nursing 22:18) found 5 to 10 mmHg to suffice with disposable towels."""


@metric("coverage@1", title="Share of the region wiped", unit="1", better="higher", only=("scrub",), order=12)
def coverage(contact: Contact) -> float | None:
    """Share of the area of the target's cells over which the tool slid at least once. 0 where it touched none; None
    (NA) where the recording has no cells."""
    return _share(contact, [(1, 0.0)])


@metric(
    "effective_wiping@1", title="Share of the region wiped clean", unit="1", better="higher", only=("scrub",), order=13
)
def effective_wiping(contact: Contact) -> float | None:
    """Share of the area that was passed as often, and with as much mean pressure, as one of CLEANS asks. 0 where the
    tool touched none; None (NA) where the recording has no cells."""
    return _share(contact, CLEANS)


EFFECTIVE_SHARE = 0.8
"""Least share of the cells' area. The studies of CLEANS call skin clean where 80 % of the dirt is gone; the same share
of the area is asked for here (assumed)."""
EFFECTIVE = CLEANS[:1]


@metric("effective@1", title="Wiped clean", unit="1", better="higher", pool=("scrub",), median=False, order=13)
def effective(contact: Contact) -> float | None:
    """1 where at least EFFECTIVE_SHARE of the area was passed three times with a mean pressure of at least 10 mmHg,
    else 0; None (NA) where the recording has no cells."""
    share = _share(contact, EFFECTIVE)
    return None if share is None else float(share >= EFFECTIVE_SHARE)


def _share(contact: Contact, enough: Sequence[tuple[int, float]]) -> float | None:
    if "scorer/cell_area_m2" not in contact.recording.arrays:
        return None
    cells = touched_cells(contact)
    return 0.0 if cells is None else wiped_share(cells, enough)


def wiped_share(cells: TouchedCells, enough: Sequence[tuple[int, float]]) -> float:
    """Share of the area for which one of (passes, least mean pressure [Pa]) holds."""
    passed = np.max([cells.share_passed(times, pressure) for times, pressure in enough], axis=0)
    return float((passed * cells.area_m2).sum() / cells.area_m2.sum())
