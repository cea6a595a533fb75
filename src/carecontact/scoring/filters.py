"""The Butterworth filters that the definitions name."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol

F64 = npt.NDArray[np.float64]
ORDER = 2


def rate_faults(protocol: Protocol) -> Iterator[str]:
    """A sentence for each filter of the definitions whose cutoff is not below half the rate of what it filters."""
    contact, rate_hz = protocol.contact, 1 / protocol.physics.dt_s
    for name, cutoff_hz, of_hz in (
        ("filter_hz", contact.filter_hz, rate_hz),
        ("peak_filter_hz", contact.peak_filter_hz, rate_hz),
        ("stroke_filter_hz", contact.stroke_filter_hz, min(contact.stroke_sample_hz, rate_hz)),
    ):
        if not 0 < cutoff_hz < of_hz / 2:
            yield f"contact.{name}: {cutoff_hz:g} is not below half of the {of_hz:g} Hz that it filters"


def low_pass(signal: F64, *, cutoff_hz: float, sample_hz: float, zero_phase: bool) -> F64:
    """Second-order Butterworth along axis 0, starting from rest; ``zero_phase`` runs it forward and backward.

    Raises ValueError if the cutoff is not below half the sample rate.
    """
    if len(signal) == 0:
        return np.array(signal, np.float64)
    library: Any = import_module(
        "scipy.signal"
    )  # ships no types; half a second that a command line need not always pay
    sections = library.butter(ORDER, cutoff_hz, fs=sample_hz, output="sos")
    if not zero_phase:
        return np.asarray(library.sosfilt(sections, signal, axis=0), np.float64)
    pad = min(len(signal) - 1, 3 * (2 * len(sections) + 1))
    return np.asarray(library.sosfiltfilt(sections, signal, axis=0, padlen=pad), np.float64)
