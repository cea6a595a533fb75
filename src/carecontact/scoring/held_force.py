"""The force that is compared with a gate's band of force: an average over a short time, so that a ripple does not end a
hold."""

from __future__ import annotations

import numpy as np

from carecontact.scoring.contact import Contact, Mask
from carecontact.scoring.filters import F64

HELD_S = 0.1
"""[s] Length of that moment; assumed, five control periods. Single steps of a contact's chatter do not leave a band,
and a mean never lies outside of what it is taken over, as a filter's ringing does. The safety gate judges every step.
"""
DIGITS = 6
"""Forces are rounded to 1e-6 N, so that a constant force at the border of a band is inside it."""


def held_force(contact: Contact) -> F64:
    """(T,) norm of the force summed over the neighbourhood, averaged over HELD_S around each step [N].

    Near the ends of the trial, the mean is over the part of HELD_S that lies in it.
    """
    half = round(HELD_S / contact.dt_s / 2)
    force = contact.neighbourhood_force
    step = np.arange(len(force))
    start, stop = np.maximum(step - half, 0), np.minimum(step + half + 1, len(force))
    total = np.concatenate([[0.0], np.cumsum(force)])
    return np.round((total[stop] - total[start]) / (stop - start), DIGITS)


def in_band(tool: F64, whole: F64, least_n: float, most_n: float) -> Mask:
    """Whether at each step the tool's force is at least ``least_n`` and that of the whole robot at most ``most_n``."""
    return (tool >= least_n) & (whole <= most_n)


def held_in_band(contact: Contact, least_n: float, most_n: float) -> Mask:
    """(T,) steps in which the tool touches the neighbourhood, its held force is at least ``least_n``, and that of the
    whole robot at most ``most_n``."""
    return contact.tool_on & in_band(held_force(contact.of_tool), held_force(contact), least_n, most_n)
