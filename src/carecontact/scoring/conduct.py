"""How a trial treated the person from first touch to last, whatever it achieved: gently, and with the tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from carecontact.protocol.gates import Conduct
from carecontact.scoring.behaviour import GatePart
from carecontact.scoring.contact import Contact, held_in_band, steps
from carecontact.scoring.metrics.cells import COMFORT_MMHG, share_below, touched_cells


def conduct(contact: Contact) -> tuple[GatePart, ...]:
    """Return the requirements that the protocol makes on the whole trial of an action; none where it makes none."""
    limits = (contact.protocol.gates.conduct or {}).get(contact.task.action)
    return () if limits is None else (*_gentle(contact, limits), *_by_tool(contact, limits))


def broken(parts: Sequence[GatePart]) -> str:
    """Return the requirements that were not met, in words that continue a sentence."""
    return "; ".join(f"{p.name[0].lower()}{p.name[1:]} was {p.reached}, {p.needed} needed" for p in parts if not p.met)


def _gentle(contact: Contact, limits: Conduct) -> list[GatePart]:
    """Forces are those of each physics step on each segment, in and outside of what counts as contact: a knock counts
    however short it is."""
    strongest = contact.force_norm.max(axis=1, initial=0.0)
    peak_n = float(strongest.max(initial=0.0))
    name = "Largest force on any segment in the whole trial"
    found = [GatePart.most(name, f"{limits.peak_n:g} N", f"{peak_n:.1f} N", peak_n <= limits.peak_n)]
    if limits.above_n is not None and limits.above_s is not None:
        above = int((strongest > limits.above_n).sum())
        name = f"Time with more than {limits.above_n:g} N on any segment"
        met = above <= int(limits.above_s / contact.dt_s + 1e-6)
        found.append(GatePart.most(name, f"{limits.above_s:g} s", f"{above * contact.dt_s:.2f} s", met))
    if limits.band_n is not None and limits.band_s is not None:
        low, high = limits.band_n
        inside = int(held_in_band(contact, low, high).sum())
        name = f"Time with {low:g} to {high:g} N on the named region or beside it"
        met = inside >= steps(limits.band_s, contact.dt_s)
        found.append(GatePart.least(name, f"{limits.band_s:g} s", f"{inside * contact.dt_s:.2f} s", met))
    if limits.comfortable_share is not None:
        cells = touched_cells(contact)
        share = None if cells is None else share_below(cells, COMFORT_MMHG)
        found.append(
            GatePart.least(
                f"Share of the contact with a mean pressure of at most {COMFORT_MMHG:g} mmHg",
                f"{limits.comfortable_share:.0%}",
                "not measured" if share is None else f"{share:.1%}",
                share is not None and share >= limits.comfortable_share,
            )
        )
    return found


def _by_tool(contact: Contact, limits: Conduct) -> list[GatePart]:
    """A trial without any contact leans on no person, and its tool did nothing."""
    if limits.tool_share is None and limits.beside_n is None:
        return []
    recording = contact.recording
    whole, beside, beside_n = float(recording["scorer/normal_force"].sum(dtype=np.float64)), 0.0, 0.0
    if "scorer/beside_normal_force" in recording:
        beside = float(recording["scorer/beside_normal_force"].sum(dtype=np.float64))
        force = recording["scorer/beside_force_in_world"]
        felt = (force != 0).any(axis=(0, 1, 3))
        parts = np.linalg.norm(force[:, :, felt].astype(np.float64).sum(axis=1), axis=-1)
        beside_n = float(parts.max(initial=0.0))
    share = 1.0 - beside / whole if whole > 0 else 0.0
    found: list[GatePart] = []
    if limits.tool_share is not None:
        name = "Share of the contact impulse on the whole person that the tool applied"
        found.append(GatePart.least(name, f"{limits.tool_share:.0%}", f"{share:.1%}", share >= limits.tool_share))
    if limits.beside_n is not None:
        name, met = "Largest force of hand and links on any segment", beside_n <= limits.beside_n
        found.append(GatePart.most(name, f"{limits.beside_n:g} N", f"{beside_n:.1f} N", met))
    return found
