"""Foam on the skin: how much of it was wiped away, and how much of the contact was where it lies.

A trial's own process and the scorer call the same code with the same numbers, those that the recording holds, so that
what a policy is shown of the foam and what it is judged by never differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import robot_of
from carecontact.recording import Recording
from carecontact.scoring.contact import F64, Contact
from carecontact.scoring.metrics.cells import EFFECTIVE, GAP_S, MMHG_PA, SLID_M
from carecontact.scoring.progress import points_in_region, region_pose

Arrays = Mapping[str, npt.NDArray[Any]]
PASSES, LEAST_PA = EFFECTIVE[0]
"""After so many passes with at least this mean pressure [Pa] skin is clean, as for ``effective@1``."""
LEAST_MMHG = LEAST_PA / MMHG_PA
ENDS_S = "scorer/period_time_s"
FELT = ("scorer/cell_press_ns", "scorer/cell_slip_m3", "scorer/cell_touch_m2s")
SHARE = "scorer/foam_cell_share"
MISSED, LIGHT, HURRIED, SELDOM = LACKING = (
    "was missed by the tool",
    f"was passed with less than {LEAST_MMHG:g} mmHg",
    f"was passed again within {GAP_S:g} s, which counts as one pass",
    f"was passed fewer than {PASSES} times",
)
"""Why foam is left on a cell, in words that continue "A share of the foam": the first that applies. A cell that was
passed often enough has foam left where the tool touched a part of it alone: there, it missed it."""


class Wiping:
    """Foam that is wiped away, period by period. C cells, of which F have foam.

    A pass is what ``TouchedCells.passes`` calls one. Each pass with at least LEAST_PA, up to PASSES of them, takes an
    equal share of the foam from the part of the cell that it touched. Only the tool wipes: of the force on the segment
    in a period, the share of the robot's other parts does not count as pressure.
    """

    def __init__(self, *, area_m2: F64, cell_share: F64) -> None:
        """``area_m2``, ``cell_share``: (C,) area of each cell, and the share of it that is under foam."""
        self._cells = np.flatnonzero(cell_share > 0)
        self._count, self._area = len(cell_share), area_m2[self._cells]
        self._weight = self._area * cell_share[self._cells]
        self._best = np.zeros((len(self._cells), PASSES))
        """(F, PASSES) largest shares of a cell that effective passes touched, falling, of visits that are over"""
        self._press, self._slip, self._touch, self._most = np.zeros((4, len(self._cells)))
        """(F,) sums over the last visit, and the largest area that was touched in a period of it [m^2]"""
        self._touched_s = np.full(len(self._cells), -np.inf)
        """(F,) end of the last period in which each cell was touched"""
        self._firm, self._light, self._again = np.zeros((3, len(self._cells)), np.int64)
        """(F,) passes of visits that are over with enough pressure and with less, and how often a touch came back
        within a visit"""
        self._now_s = 0.0

    def add(self, period_s: float, *, press_ns: F64, slip_m3: F64, touch_m2s: F64, tool_share: float) -> bool:
        """Add a control period and what each cell (C,) felt in it; returns whether foam was touched.

        ``tool_share``: share of the normal force on the segment that was the tool's.
        """
        touch, began_s = touch_m2s[self._cells], self._now_s
        self._now_s += period_s
        on = touch > 0
        if not on.any():
            return False
        away_s = began_s - self._touched_s
        self._close(on & (away_s > GAP_S))
        self._again[on & (away_s > 0) & (away_s <= GAP_S)] += 1
        self._press += np.where(on, press_ns[self._cells] * tool_share, 0.0)
        self._slip += np.where(on, slip_m3[self._cells], 0.0)
        self._touch += touch
        self._most = np.maximum(self._most, touch / period_s)
        self._touched_s[on] = self._now_s
        return True

    def _close(self, over: npt.NDArray[np.bool_]) -> None:
        """End the visits of these cells (F,)."""
        self._best[over] = self._with_last()[over]
        slid, firm = self._last()
        self._firm[over] += firm[over]
        self._light[over] += (slid & ~firm)[over]
        for sums in (self._press, self._slip, self._touch, self._most):
            sums[over] = 0.0

    def _last(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """(F,) whether the last visit as it stands is a pass, and one with enough pressure."""
        slid = (self._slip >= SLID_M * self._most) & (self._touch > 0)
        return slid, slid & (self._press >= LEAST_PA * self._touch)

    def _with_last(self) -> F64:
        """(F, PASSES) like ``_best``, with the last visit as it stands."""
        share = np.where(self._last()[1], np.minimum(1.0, self._most / self._area), 0.0)
        return -np.sort(-np.column_stack([self._best, share]), axis=1)[:, :PASSES]

    @property
    def left(self) -> F64:
        """(C,) share of its foam that each cell still has."""
        out = np.ones(self._count)
        out[self._cells] = 1.0 - self._with_last().mean(axis=1)
        return out

    @property
    def cleaned(self) -> float:
        """Share of the foam's area that was passed PASSES times with at least LEAST_PA."""
        return float((self._with_last()[:, -1] * self._weight).sum() / self._weight.sum())

    @property
    def lacking(self) -> dict[str, float]:
        """Reason (one of LACKING) -> share of the foam's area that it left; they add up to all that is not
        ``cleaned``."""
        slid, last_firm = self._last()
        firm, light = self._firm + last_firm, self._light + (slid & ~last_firm)
        missed = np.isneginf(self._touched_s) | (firm >= PASSES)
        enough = [missed, firm + light >= PASSES, firm + light + self._again >= PASSES]
        reason = np.select(enough, [0, 1, 2], 3)
        left = (1.0 - self._with_last()[:, -1]) * self._weight / self._weight.sum()
        return dict(zip(LACKING, np.bincount(reason, left, len(LACKING)).tolist(), strict=True))


def share_of_tool(normal: npt.NDArray[Any], beside_normal: npt.NDArray[Any] | None) -> float:
    """Share of a normal force (n,) over a period that was the tool's; ``beside_normal`` (n, 2): of hand and links."""
    whole = float(normal.sum(dtype=np.float64))
    if beside_normal is None or whole <= 0:
        return 1.0
    return max(0.0, 1.0 - float(beside_normal.sum(dtype=np.float64)) / whole)


def new_wiping(arrays: Arrays) -> Wiping | None:
    """Return a trial's wiping before its first period; None without foam on cells."""
    if SHARE not in arrays or not arrays[SHARE].any():
        return None
    area, share = arrays["scorer/cell_area_m2"], arrays[SHARE]
    return Wiping(area_m2=area.astype(np.float64), cell_share=share.astype(np.float64))


class RecordedWiping:
    """The wiping of a recorded trial, which goes on in time and not back."""

    def __init__(self, recording: Recording, wiping: Wiping) -> None:
        header, arrays = recording.header, recording.arrays
        segment = REGIONS[header.spec.protocol.task(header.spec.task_id).region].segment
        target, self._dt_s = header.segments.index(segment), header.spec.protocol.physics.dt_s
        self._wiping, self._at, self._step = wiping, 0, 0
        # A trial that ended before its first period has no rows of the cells.
        self._ends_s = arrays[ENDS_S] if FELT[0] in arrays else np.empty(0)
        self._steps = np.rint(self._ends_s / self._dt_s).astype(np.int64)
        self._lengths_s = np.diff(self._ends_s, prepend=0.0)
        self._felt = [arrays[path] for path in FELT if path in arrays]
        self._normal, beside = arrays["scorer/normal_force"][:, target], arrays.get("scorer/beside_normal_force")
        self._beside = None if beside is None else beside[:, :, target]

    @classmethod
    def of(cls, recording: Recording) -> Self | None:
        """None for a trial without foam on cells, such as a touch on the flank of a limb."""
        wiping = new_wiping(recording.arrays)
        return None if wiping is None else cls(recording, wiping)

    def until(self, time_s: float) -> Wiping:
        """Return the wiping after the control periods that have ended by then; the next call changes it."""
        while self._at < len(self._ends_s) and self._ends_s[self._at] <= time_s + self._dt_s / 2:
            at, mine = self._at, slice(self._step, int(self._steps[self._at]))
            press, slip, touch = (rows[at].astype(np.float64) for rows in self._felt)
            share = share_of_tool(self._normal[mine], None if self._beside is None else self._beside[mine])
            self._wiping.add(
                float(self._lengths_s[at]), press_ns=press, slip_m3=slip, touch_m2s=touch, tool_share=share
            )
            self._at, self._step = at + 1, mine.stop
        return self._wiping


def cleaned_share(contact: Contact) -> float | None:
    """Share of the foam's area that the tool wiped clean; None where there was no foam on cells."""
    if "cleaned" not in contact.known and (found := RecordedWiping.of(contact.recording)) is not None:
        whole = found.until(np.inf)
        contact.known.update(whole.lacking, cleaned=whole.cleaned)
    return contact.known.get("cleaned")


LEAST_NAMED = 0.05
"""Least share of the foam for which a reason is named."""


@dataclass(frozen=True, kw_only=True)
class FoamCleaning:
    """How much of the foam a scrub cleaned, and how much it had to."""

    share: float
    least: float
    lacking: dict[str, float]
    """See ``Wiping.lacking``."""

    @classmethod
    def of(cls, contact: Contact) -> Self | None:
        """None where the region has no foam, or the protocol no gate for it."""
        gate, share = contact.protocol.gates.foam, cleaned_share(contact)
        if gate is None or share is None:
            return None
        return cls(share=share, least=gate.cleaned_share, lacking={why: contact.known[why] for why in LACKING})

    @property
    def met(self) -> bool:
        return self.share >= self.least

    def __str__(self) -> str:
        most = sorted(((part, why) for why, part in self.lacking.items()), reverse=True)
        return (
            f"{self.share:.0%} of the foam was passed {PASSES} times by the tool with at least {LEAST_MMHG:g} mmHg, "
            f"{self.least:.0%} needed" + "".join(f"; {part:.0%} {why}" for part, why in most if part >= LEAST_NAMED)
        )


def at_foam(contact: Contact) -> bool:
    """Whether the contact was where the foam lies, as far as a task asks for that: a scrub has to clean it instead."""
    gate = contact.protocol.gates.foam
    if gate is None or contact.task.action == "scrub":
        return True
    share = place_share(contact, gate.within_m)
    return SHARE not in contact.recording or (share is not None and share >= gate.impulse_share)


def place_share(contact: Contact, within_m: float) -> float | None:
    """Share of the contact impulse that the tool gave with its middle near the foam's; None without foam or contact.

    The distance is along the skin, in the plane that touches it at the foam's middle: how deep the tool presses does
    not count, and neither does how it is tilted, since its middle is that of the rounded tip.
    """
    recording, total = contact.recording, float(contact.impulse_ns.sum())
    if SHARE not in recording or total <= 0:
        return None
    pose, _ = region_pose(contact, contact.task.region, np.arange(len(contact.time_s)))
    tool = recording["scorer/pose_tcp_in_world"].astype(np.float64)
    robot = robot_of(recording.header.embodiment)
    back_m = 0.0 if robot is None else robot.tip.half_m[2]
    middle = points_in_region(tool[:, :3] - back_m * matrix_from_quat(tool[:, 3:])[:, :, 2], pose)
    foam = recording["scorer/foam_pose_in_region"]
    off = (middle - foam[:3]) @ matrix_from_quat(foam[3:])[:, :2]
    there = contact.tool_on & (np.linalg.norm(off, axis=1) <= within_m)
    return min(1.0, float(contact.tool_force[there].sum()) * contact.dt_s / total)
