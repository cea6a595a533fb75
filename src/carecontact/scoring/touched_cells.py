"""What small patches of the target region felt: pressure, visits of the tool, and the area that it slid over.

*Cells* are patches of the region's skin (``scorer/cell_*`` of a recording), for which each row of the recording sums a
control period. P control periods, C cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from carecontact.scoring.contact import Contact, runs
from carecontact.scoring.filters import F64

MMHG_PA = 133.322
"""[Pa] one millimetre of mercury, in which nursing studies give the pressure of wiping."""
LEAST_TOUCHED = 0.25
"""Smallest share of a cell, in time and area, that a mean pressure is taken over. A corner of a cell that the tool's
rim barely meets would otherwise say what the mesh is like and not what the skin feels; assumed."""
GAP_S = 0.1
"""[s] A visit goes on across interruptions of at most this length; assumed, a fifth of a quick wipe."""
SLID_M = 0.003
"""[m] A visit is a pass only where the tool slides this far over the skin that it touches. Skin that sticks to the tool
and is carried along is not wiped; assumed, above the 1 to 2 mm by which a press from straight above slides."""


@dataclass(frozen=True, kw_only=True)
class Passes:
    """Each time that the tool slid over a cell. N passes, in no particular order."""

    cell: npt.NDArray[np.intp]
    """(N,) index of the cell"""
    share: F64
    """(N,) share of the cell's area that was touched when most of it was"""
    pressure_pa: F64
    """(N,) mean contact pressure during the pass, over the area in contact"""


@dataclass(frozen=True, kw_only=True)
class TouchedCells:
    area_m2: F64
    """(C,)"""
    period_s: F64
    """(P,) length of each control period"""
    press_ns: F64
    """(P, C) normal force times time"""
    shear_ns: F64
    """(P, C) size of the friction force times time"""
    slip_m3: F64
    """(P, C) distance that the tool slid times the area over which it slid"""
    touch_m2s: F64
    """(P, C) area in contact times time"""

    @property
    def pressure_pa(self) -> F64:
        """(P, C) mean pressure over the area in contact, or over LEAST_TOUCHED of the cell where less is touched."""
        return self.press_ns / np.maximum(self.touch_m2s, LEAST_TOUCHED * self.period_s[:, None] * self.area_m2)

    @property
    def mean_pressure_pa(self) -> float:
        """Mean pressure over all area and time in contact [Pa]; there has to be some."""
        return float(self.press_ns.sum() / self.touch_m2s.sum())

    def time_above(self, pressure_pa: float) -> float:
        """Time [s] in which any cell bears more than a pressure."""
        return float(self.period_s[(self.pressure_pa > pressure_pa).any(axis=1)].sum())

    def share_of_time_below(self, pressure_pa: float) -> float:
        """Share of the time in contact in which the mean pressure over all cells is at most this; there has to be
        contact."""
        touch = self.touch_m2s.sum(axis=1)
        held = touch > 0
        low = self.press_ns.sum(axis=1)[held] <= pressure_pa * touch[held]
        return float(self.period_s[held][low].sum() / self.period_s[held].sum())

    @cached_property
    def passes(self) -> Passes:
        """A *visit* of a cell lasts while the tool touches it; a visit is a pass if the tool slid by SLID_M."""
        cell: list[int] = []
        share: list[float] = []
        pressure: list[float] = []
        for c in np.flatnonzero((self.touch_m2s > 0).any(axis=0)).tolist():
            for start, stop in self._visits(c):
                touch, press, slip = (a[start:stop, c] for a in (self.touch_m2s, self.press_ns, self.slip_m3))
                most = float((touch / self.period_s[start:stop]).max())
                if slip.sum() < SLID_M * most:
                    continue
                cell.append(c)
                share.append(min(1.0, most / self.area_m2[c]))
                pressure.append(float(press.sum() / touch.sum()))
        return Passes(cell=np.array(cell, np.intp), share=np.array(share), pressure_pa=np.array(pressure))

    def _visits(self, cell: int) -> list[tuple[int, int]]:
        """[start, stop) periods of each visit."""
        ends = np.cumsum(self.period_s)
        joined: list[tuple[int, int]] = []
        for start, stop in runs(self.touch_m2s[:, cell] > 0).tolist():
            if joined and ends[start - 1] - ends[joined[-1][1] - 1] <= GAP_S:
                joined[-1] = (joined[-1][0], stop)
            else:
                joined.append((start, stop))
        return joined

    def share_passed(self, times: int, pressure_pa: float = 0.0) -> F64:
        """(C,) share of each cell that the tool passed at least ``times`` times with at least a mean pressure.

        Passes of one cell are assumed to cover the same part of it as far as they can: of three that touch 0.5, 0.8 and
        1.0 of a cell, 0.8 is passed twice.
        """
        found, out = self.passes, np.zeros(len(self.area_m2))
        hard = found.pressure_pa >= pressure_pa
        for c in np.unique(found.cell[hard]):
            shares = np.sort(found.share[hard & (found.cell == c)])[::-1]
            out[c] = shares[times - 1] if len(shares) >= times else 0.0
        return out


def touched_cells(contact: Contact) -> TouchedCells | None:
    """Return what the region's cells felt; None where no cell was touched, and for recordings without cells, of rigid
    regions."""
    arrays = contact.recording.arrays
    if "scorer/cell_touch_m2s" not in arrays or not arrays["scorer/cell_touch_m2s"].any():
        return None
    area, press, shear, slip, touch = (
        arrays[f"scorer/cell_{name}"].astype(np.float64)
        for name in ("area_m2", "press_ns", "shear_ns", "slip_m3", "touch_m2s")
    )
    period = np.diff(arrays["scorer/period_time_s"], prepend=0.0)
    return TouchedCells(area_m2=area, period_s=period, press_ns=press, shear_ns=shear, slip_m3=slip, touch_m2s=touch)
