"""How often the tool passed each part of the region's axis, and with what force it slid."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from carecontact.scoring.contact import Contact, Mask, runs
from carecontact.scoring.filters import F64
from carecontact.scoring.held_force import held_force, in_band
from carecontact.scoring.progress import Track, surface_track, turning_points

STEP_M = 0.001
"""Length of the parts of the axis that are counted."""


@dataclass(frozen=True, kw_only=True)
class Wiping:
    """The tool's way over the target region's surface with the force at each sample (50 Hz); N samples."""

    track: Track
    force: F64
    """(N,) held force of the tool [N]"""
    whole: F64
    """(N,) held force of the whole robot [N]"""
    length_m: float
    """Length of the region's axis."""
    reversal_m: float
    """Opposite travel that begins another stroke."""
    moving: Mask
    """(N - 1,) in contact from one sample to the next and sliding faster than the least speed that counts as motion"""

    def passes(self, least_n: float) -> npt.NDArray[np.intp]:
        """(K,) how often each STEP_M of the axis was passed with at least this force.

        A *stroke* is the path between two turns or lifts, and passes each place at most once: trembling on a place is
        no wiping. Strokes count in either direction, also where the tool is lifted and comes back through the air, as
        a nurse may wipe.
        """
        count = np.zeros(round(self.length_m / STEP_M), np.intp)
        axis = self.track.surface[:, 0]
        hard = self.force >= least_n
        for start, stop in runs(self.track.joined).tolist():
            ends = [0, *turning_points(axis[start : stop + 1], self.reversal_m), stop - start]
            for first, last in pairwise(ends):
                stroke = slice(start + first, start + last + 1)
                count += self._covered(axis[stroke], hard[stroke], len(count))
        return count

    def _covered(self, axis: F64, hard: Mask, parts: int) -> Mask:
        """(K,) which parts' middles one stroke goes over while it is pressed hard enough."""
        found = np.zeros(parts, np.bool_)
        for start, stop in runs(hard).tolist():
            place = (axis[start:stop] + self.length_m / 2) / STEP_M - 0.5
            low, high = int(np.ceil(place.min())), int(np.floor(place.max()))
            found[max(low, 0) : max(high + 1, 0)] = True
        return found

    def passed_m(self, times: float, least_n: float) -> float:
        """Length of the axis that was passed at least so often with at least this force [m]."""
        return float((self.passes(least_n) >= times).sum()) * STEP_M

    def share_in_band(self, least_n: float, most_n: float) -> float | None:
        """Share of the time of sliding with at least ``least_n`` of the tool and at most ``most_n`` of the whole robot;
        None where the tool never slid."""
        tool, whole = self.force[1:][self.moving], self.whole[1:][self.moving]
        return float(in_band(tool, whole, least_n, most_n).mean()) if len(tool) else None


def wiping(contact: Contact) -> Wiping:
    """Return how the tool slid over the whole trial, because what slid too hard counts in whichever contact it was."""
    definition, track = contact.protocol.contact, surface_track(contact.of_tool)
    speed = np.linalg.norm(np.diff(track.surface, axis=0), axis=1) / np.diff(contact.time_s[track.step])
    region = contact.recording.header.regions.index(contact.task.region)
    return Wiping(
        track=track,
        force=held_force(contact.of_tool)[track.step],
        whole=held_force(contact)[track.step],
        length_m=float(contact.recording["scorer/region_size_m"][region, 0]),
        reversal_m=definition.reversal_m,
        moving=track.joined & (speed >= definition.active_speed_m_s),
    )
