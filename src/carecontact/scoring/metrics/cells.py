"""Metrics of the skin cell by cell: pressure, shear, and how much of a region was wiped."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.regions import REGIONS
from carecontact.scoring.contact import F64, Contact, joined, runs
from carecontact.scoring.limits import LIMIT_PACKS, UNCHECKED
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.progress import surface_normal

# What small patches of the target region felt: pressure, visits of the tool, and the area that it slid over.
#
# *Cells* are patches of the region's skin (``scorer/cell_*`` of a recording), for which each row of the recording sums
# a control period. P control periods, C cells.

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

    def time_above(self, pressure_pa: float) -> float:
        """Time [s] in which any cell bears more than a pressure."""
        return float(self.period_s[(self.pressure_pa > pressure_pa).any(axis=1)].sum())

    @cached_property
    def passes(self) -> list[tuple[int, float, float]]:
        """Each time that the tool slid over a cell: the cell, the share of its area that was touched when most of it
        was, and the mean pressure [Pa] over the area in contact.

        A *visit* of a cell lasts while the tool touches it; a visit is a pass if the tool slid by SLID_M.
        """
        found: list[tuple[int, float, float]] = []
        ends = np.cumsum(self.period_s)
        for c in np.flatnonzero((self.touch_m2s > 0).any(axis=0)).tolist():
            touched = runs(self.touch_m2s[:, c] > 0)
            for start, stop in joined(touched, lambda before, start: ends[start - 1] - ends[before - 1] <= GAP_S):
                touch, press, slip = (a[start:stop, c] for a in (self.touch_m2s, self.press_ns, self.slip_m3))
                most = float((touch / self.period_s[start:stop]).max())
                if slip.sum() >= SLID_M * most:
                    found.append((c, min(1.0, most / self.area_m2[c]), float(press.sum() / touch.sum())))
        return found

    def share_passed(self, times: int, pressure_pa: float = 0.0) -> F64:
        """(C,) share of each cell that the tool passed at least ``times`` times with at least a mean pressure.

        Passes of one cell are assumed to cover the same part of it as far as they can: of three that touch 0.5, 0.8 and
        1.0 of a cell, 0.8 is passed twice.
        """
        out, of_cell = np.zeros(len(self.area_m2)), defaultdict[int, list[float]](list)
        for cell, share, pressure in self.passes:
            if pressure >= pressure_pa:
                of_cell[cell].append(share)
        for c, shares in of_cell.items():
            shares.sort(reverse=True)
            out[c] = shares[times - 1] if len(shares) >= times else 0.0
        return out


def touched_cells(contact: Contact) -> TouchedCells | None:
    """Return what the region's cells felt; None where none was touched or the region is rigid."""
    arrays = contact.recording.arrays
    if "scorer/cell_touch_m2s" not in arrays or not arrays["scorer/cell_touch_m2s"].any():
        return None
    area, press, shear, slip, touch = (
        arrays[f"scorer/cell_{name}"].astype(np.float64)
        for name in ("area_m2", "press_ns", "shear_ns", "slip_m3", "touch_m2s")
    )
    period = np.diff(arrays["scorer/period_time_s"], prepend=0.0)
    return TouchedCells(area_m2=area, period_s=period, press_ns=press, shear_ns=shear, slip_m3=slip, touch_m2s=touch)


MOST_OF_FORCE = 0.5
"""Share of the normal force, integrated over time, that the cells must have felt for a number about their pressure;
assumed: a number about the pressure under the tool has to rest on most of its force."""
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


def of_cells(id_: str, *, unit: str = "1", **description: Any) -> Callable[[Measure], Measure]:
    """Register a measure that is NA where no cell was touched, or cells felt less than MOST_OF_FORCE."""

    def register(measure: Measure) -> Measure:
        @metric(id_, unit=unit, **description)
        def _(contact: Contact) -> float | None:
            share, cells = cell_share(contact), touched_cells(contact)
            return None if cells is None or share is None or share < MOST_OF_FORCE else measure(cells, contact)

        return measure

    return register


# Pressure and shear on the skin of the target region. Every metric here speaks of the region's cells alone.

COMFORT_MMHG = 25.0
"""Upper end of the ordinary wiping of nurses, at which 31 % of 30 adults felt slight pain: Konya et al. 2020 (Japan
Journal of Nursing Science; only its abstract was read)."""
FRAGILE_MMHG = 14.0
"""Upper end of weak wiping in the same study, at which 11 % felt slight pain, people with sensitive skin among them."""
MOST_OF_TIME = 0.95
"""Share of the time in contact; assumed. The studies give the pressure of whole wipes, so a single moment is not
compared with them, but neither may a hard stroke hide in the mean of a trial."""
PAIN_PACK = "iso-ts-15066-2016-pressure"
ANSWER: dict[str, Any] = {"better": "higher", "only": ("scrub",), "median": False}
"""A yes (1) or a no (0) about wiping; tables count the yes."""
FRAGILE = "(fragile skin)"


@of_cells("pressure_mean@2", title="Mean pressure in contact", unit="kPa", better="neither", order=14)
def mean_pressure(cells: TouchedCells, contact: Contact) -> float:
    """Normal force over area in contact, over all of the contact of the target's cells."""
    return float(cells.press_ns.sum() / cells.touch_m2s.sum()) / 1000


@of_cells("pressure_peak@2", title="Peak pressure", unit="kPa", better="lower", order=15)
def peak_pressure(cells: TouchedCells, contact: Contact) -> float:
    """Largest ``TouchedCells.pressure_pa`` of a cell and a control period."""
    return float(cells.pressure_pa.max()) / 1000


@of_cells("exposure_uncomfortable@2", title=f"Time above {COMFORT_MMHG:g} mmHg", unit="s", better="lower", order=33)
def uncomfortable(cells: TouchedCells, contact: Contact) -> float:
    """Time in which a cell of the target bears more than COMFORT_MMHG."""
    return cells.time_above(COMFORT_MMHG * MMHG_PA)


@of_cells("exposure_fragile@2", title=f"Time above {FRAGILE_MMHG:g} mmHg {FRAGILE}", unit="s", better="lower", order=34)
def fragile(cells: TouchedCells, contact: Contact) -> float:
    return cells.time_above(FRAGILE_MMHG * MMHG_PA)


@of_cells("comfortable@2", title=f"Wiped below {COMFORT_MMHG:g} mmHg", order=35, **ANSWER)
def comfortable(cells: TouchedCells, contact: Contact) -> float:
    """1 where the pressure under the tool stays at or below COMFORT_MMHG for MOST_OF_TIME of its time in contact, else
    0."""
    return _stays_below(cells, COMFORT_MMHG)


@of_cells("comfortable_fragile@2", title=f"Wiped below {FRAGILE_MMHG:g} mmHg {FRAGILE}", order=36, **ANSWER)
def comfortable_fragile(cells: TouchedCells, contact: Contact) -> float:
    return _stays_below(cells, FRAGILE_MMHG)


def share_below(cells: TouchedCells, mmhg: float) -> float:
    """Share of the time in contact with at most this mean pressure, as a sensor on the whole tool would read it: force
    over area in contact, in each control period."""
    touch = cells.touch_m2s.sum(axis=1)
    held = touch > 0
    low = cells.press_ns.sum(axis=1)[held] <= mmhg * MMHG_PA * touch[held]
    return float(cells.period_s[held][low].sum() / cells.period_s[held].sum())


def _stays_below(cells: TouchedCells, mmhg: float) -> float:
    return float(share_below(cells, mmhg) >= MOST_OF_TIME)


@of_cells(
    "pressure_utilisation@2",
    title=f"Peak pressure relative to the ISO/TS 15066 pressure limit{UNCHECKED}",
    better="lower",
    detail=True,
    order=51,
)
def pressure_utilisation(cells: TouchedCells, contact: Contact) -> float:
    """``pressure_peak`` as a share of what pack iso-ts-15066-2016-pressure allows the target's segment."""
    return float(cells.pressure_pa.max()) / LIMIT_PACKS[PAIN_PACK].limit(contact.segments[contact.target])


@of_cells("shear_dose@2", title="Shear dose", unit="N s", better="lower", order=61)
def shear_dose(cells: TouchedCells, contact: Contact) -> float:
    """Integral over time of the size of the friction force, summed over the target's cells. Shear that goes back and
    forth adds up, and so does shear in opposite directions on two cells. No limit of it was found in the literature."""
    return float(cells.shear_ns.sum())


@metric("shear_work@1", title="Net shear work", unit="J", better="neither", detail=True, order=60)
def shear_work(contact: Contact) -> float | None:
    """Tangential contact force on the reported region times tangential slip of the tool point over it [J], net.

    Both in the bone's frame, so that carrying the arm is not slip; tangential to the region's elliptic surface at the
    tool. The force of a step times the travel to the next, where both steps lie in the contact window. Stretching the
    tissue back and forth cancels; what stays is what friction dissipated. In a touch, which does
    not slide, it is near zero, and negative where the skin moves the tool. None (NA) without valid contact and where
    the reported segment has no region, because no frame of it is recorded.
    """
    recording = contact.recording
    if not contact.valid or contact.reported is None:
        return None
    names, segment = recording.header.regions, contact.segments[contact.reported]
    region = next((k for k, name in enumerate(names) if name in REGIONS and REGIONS[name].segment == segment), None)
    if region is None:
        return None
    joined = contact.window[1:] & contact.window[:-1]
    both = np.flatnonzero(joined)
    step = np.flatnonzero(np.concatenate([joined, [False]]) | np.concatenate([[False], joined]))
    pose = recording["scorer/region_pose_in_world"][step, region].astype(np.float64)
    to_region = matrix_from_quat(pose[:, 3:])
    offset = recording["scorer/pose_tcp_in_world"][step, :3].astype(np.float64) - pose[:, :3]
    point = np.einsum("nij,ni->nj", to_region, offset)
    force_in_world = recording["scorer/force_human_from_robot_in_world"][step, contact.reported].astype(np.float64)
    force = np.einsum("nij,ni->nj", to_region, force_in_world)
    normal = surface_normal(point, recording["scorer/region_size_m"][region])
    tangential = force - (force * normal).sum(axis=1, keepdims=True) * normal

    here = np.searchsorted(step, both)
    travel = point[here + 1] - point[here]  # of which the tangential force sees the tangential part
    return float((tangential[here] * travel).sum())


# How much of the region was wiped, and how much of it well enough to be clean.

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
    """Share of the area for which one of (passes, least mean pressure [Pa]) holds."""
    if "scorer/cell_area_m2" not in contact.recording.arrays:
        return None
    cells = touched_cells(contact)
    if cells is None:
        return 0.0
    passed = np.max([cells.share_passed(times, pressure) for times, pressure in enough], axis=0)
    return float((passed * cells.area_m2).sum() / cells.area_m2.sum())
