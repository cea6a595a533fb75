"""The Butterworth filters that the definitions name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class _Section:
    """y_n = b (x_n + 2 x_n-1 + x_n-2) - a1 y_n-1 - a2 y_n-2: every number that scipy.signal gives, bit for bit. A
    second of the shortest command goes into importing that package."""

    b: float
    a1: float
    a2: float

    @classmethod
    def butterworth(cls, cutoff_hz: float, sample_hz: float) -> _Section:
        """Second order, by the bilinear transform with the cutoff prewarped."""
        warped = float(4 * np.tan(np.pi * (2 * cutoff_hz / sample_hz) / 2))
        poles = warped * -np.exp(1j * np.pi * np.array([-1.0, 1.0]) / 4)
        gain = warped**2 * (1 / np.prod(4 - poles)).real
        moved, mirrored = (4 + poles) / (4 - poles)
        pole = (moved + mirrored.conj()) / 2
        _, a1, a2 = np.poly([pole, pole.conj()]).tolist()
        return cls(b=float(gain), a1=a1, a2=a2)

    @property
    def steady(self) -> tuple[float, float]:
        """The memory after a long signal of 1."""
        b, a1, a2 = self.b, self.a1, self.a2
        near, far = np.linalg.solve([[1 + a1, -1.0], [a2, 1.0]], [2 * b - a1 * b, b - a2 * b]).tolist()
        return near, far

    def run(self, signal: list[float], share: float = 0.0) -> list[float]:
        """Filter a signal that was ``share`` for long before it begins; 0 is rest."""
        b, a1, a2, middle = self.b, self.a1, self.a2, 2 * self.b
        near, far = (z * share for z in self.steady)
        out: list[float] = []
        for x in signal:
            y = b * x + near
            near = middle * x - a1 * y + far
            far = b * x - a2 * y
            out.append(y)
        return out


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
    if not 0 < cutoff_hz < sample_hz / 2:
        raise ValueError(f"a cutoff of {cutoff_hz:g} Hz is not below half of the {sample_hz:g} Hz that it filters")
    section = _Section.butterworth(cutoff_hz, sample_hz)
    columns = np.asarray(signal, np.float64).reshape(len(signal), -1).T.tolist()
    filtered = [(_both_ways(section, column) if zero_phase else section.run(column)) for column in columns]
    return np.array(filtered, np.float64).T.reshape(np.shape(signal))


def _both_ways(section: _Section, signal: list[float]) -> list[float]:
    """Run forward and backward over the signal and its point reflections at both ends."""
    pad = min(len(signal) - 1, 9)
    before = [2 * signal[0] - x for x in signal[pad:0:-1]]
    after = [2 * signal[-1] - x for x in signal[-2 : -pad - 2 : -1]]
    extended = [*before, *signal, *after]
    forward = section.run(extended, extended[0])[::-1]
    return section.run(forward, forward[0])[::-1][pad : pad + len(signal)]
