"""exposure_*@1: how long the force on the person was above 10 N, above the safety gate and above the pain limit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric

COMFORT_N = 10.0
"""[N] A level that this benchmark chose, not a published limit; above measured wiping forces (about 3 N, King 2010) and
below every safety gate (21 N on the abdomen)."""


def exposure(contact: Contact, limit_n: Callable[[str], float]) -> float | None:
    """Time during which any touched segment's force norm exceeds its limit [s]; None (NA) without valid contact.

    Reads the whole trial and not the contact window, as the safety gate does. ``limit_n``: segment -> limit [N].
    """
    if not contact.valid:
        return None
    touched = contact.touched
    limits = np.array([limit_n(contact.segments[i]) for i in touched])
    return int((contact.force_norm[:, touched] > limits).any(axis=1).sum()) * contact.dt_s


@metric("exposure_comfort@1", title=f"Time above {COMFORT_N:g} N", unit="s", better="lower", order=30)
def above_comfort(contact: Contact) -> float | None:
    return exposure(contact, lambda _: COMFORT_N)


@metric("exposure_gate@1", title="Time above the safety gate", unit="s", better="lower", order=31)
def above_gate(contact: Contact) -> float | None:
    """Above gamma' F_pain of the segment."""
    return exposure(contact, lambda segment: contact.protocol.limits.gamma * contact.protocol.f_pain(segment))


@metric("exposure_pain@1", title="Time above the pain limit", unit="s", better="lower", order=32)
def above_pain(contact: Contact) -> float | None:
    return exposure(contact, contact.protocol.f_pain)
