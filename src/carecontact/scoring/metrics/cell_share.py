"""cell_share@1: how much of the contact the target region's cells felt, and so what their pressure can speak for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metric_fields import Better
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.touched_cells import TouchedCells, touched_cells

MOST_OF_FORCE = 0.5
"""Share of the normal force, integrated over time, that the cells must have felt for a number about their pressure;
assumed: what is said of the pressure under the tool has to rest on most of its force."""
Measure = Callable[[TouchedCells, Contact], float]


@metric("cell_share@1", title="Share of the force that the region's cells felt", unit="1", better="neither", order=11)
def cell_share(contact: Contact) -> float | None:
    """Normal force on the cells over the normal force of the robot on all segments, each integrated over the control
    periods that the recording has. 0 where the person was pressed and no cell was; None (NA) without any force, and for
    a recording without cells."""
    arrays = contact.recording.arrays
    if "scorer/cell_press_ns" not in arrays or not arrays["scorer/period_time_s"].size:
        return None
    normal = contact.recording["scorer/normal_force"]
    # A sample has the time at which its physics step began, a period that at which its last step ended.
    within = contact.time_s < arrays["scorer/period_time_s"][-1] - contact.dt_s / 2
    whole = float(normal[within].sum(dtype=np.float64)) * contact.dt_s
    felt = float(arrays["scorer/cell_press_ns"].sum(dtype=np.float64))
    return min(felt / whole, 1.0) if whole > 0 else None


def of_cells(
    name: str, *, title: str, better: Better, order: int, unit: str = "1", answer: bool = False
) -> Callable[[Measure], Measure]:
    """Register a measure of the touched cells as ``NAME@2``, which is NA where no cell was touched, and where the cells
    felt less than MOST_OF_FORCE of the contact.

    Args:
        answer: whether the value is a yes (1) or a no (0) about wiping, of which tables count the yes.
    """

    def register(measure: Measure) -> Measure:
        def compute(contact: Contact) -> float | None:
            share, cells = cell_share(contact), touched_cells(contact)
            return None if cells is None or share is None or share < MOST_OF_FORCE else measure(cells, contact)

        compute.__doc__ = measure.__doc__
        metric(
            f"{name}@2", title=title, unit=unit, better=better, only=("scrub",) if answer else None, median=not answer,
            order=order,
        )(compute)  # fmt: skip
        return measure

    return register
