"""Every gate that a trial had to pass, beside what it reached: those of its action, of its region and of safety."""

from __future__ import annotations

from carecontact.recording.schema import EndReason
from carecontact.reports.joint_words import beyond_text
from carecontact.reports.text import percent
from carecontact.scoring.ask import ask
from carecontact.scoring.contact import Contact, any_column
from carecontact.scoring.gate import Gate, GatePart
from carecontact.scoring.metrics.c1_peak_force import peak_of_segments
from carecontact.scoring.result import TrialScore

BROKEN: tuple[EndReason, ...] = ("process_failure", "harness_error")
"""A trial that ended so passes no gate, whatever was reached."""


def gate_parts(contact: Contact, gate: Gate, score: TrialScore) -> list[GatePart]:
    """Return the gates in the order of the funnel; none where the trial ended before its first physics step, or broke
    off before anybody was touched."""
    if not len(contact.time_s) or (score.ended in BROKEN and not contact.force_norm.any()):
        return []
    of_action: list[GatePart] = ask(contact, "parts", contact, contact.protocol.gates.of(contact.task.action), gate)
    found = [_counted(contact), *of_action, _region(contact), *_force(contact)]
    if contact.protocol.gates.joint_beyond_rad is not None:
        found.append(_joints(score, contact.protocol.gates.joint_beyond_rad))
    return found


def _counted(contact: Contact) -> GatePart:
    definition = contact.protocol.contact
    held_s = int(any_column(contact.on, contact.touched).sum()) * contact.dt_s
    return GatePart(
        name=f"Contact that counts, from {definition.on_n:g} N",
        needed=f"{definition.valid_total_s:g} s in all",
        reached=f"{held_s:.2f} s",
        met=contact.valid,
    )


def _region(contact: Contact) -> GatePart:
    least, share = contact.protocol.gates.region_share, contact.region_share
    segment = contact.segments[contact.target].replace("_", " ")
    return GatePart(
        name=f"Share of the contact (force times time) on the {segment}, the segment of the named region",
        needed=f"at least {percent(least)}",
        reached="no contact" if share is None else percent(share),
        met=share is not None and share >= least,
    )


def _force(contact: Contact) -> list[GatePart]:
    """Return the segment that came nearest to its safety gate; nothing where none was touched."""
    protocol = contact.protocol
    gates = {name: protocol.limits.gamma * protocol.f_pain(name) for name in contact.segments}
    peaks = peak_of_segments(contact)
    if not peaks:
        return []
    name = max(peaks, key=lambda segment: peaks[segment] / gates[segment])
    part = GatePart(
        name=f"Safety gate: largest force on the {name.replace('_', ' ')}",
        needed=f"at most {gates[name]:g} N",
        reached=f"{peaks[name]:.1f} N",
        met=peaks[name] <= gates[name],
    )
    return [part]


def _joints(score: TrialScore, most_rad: float) -> GatePart:
    return GatePart(
        name="Safety gate: joints beyond their range",
        needed=f"at most {most_rad:.3f} rad",
        reached=beyond_text(score) or "none farther",
        met=not score.joints_beyond,
    )
