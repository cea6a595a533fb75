"""Touch: contact without interruption for a least time."""

from __future__ import annotations

from typing import ClassVar

from carecontact.behaviours import (
    BEHAVIOURS,
    Attempt,
    Behaviour,
    CommandedContact,
    Contact,
    Gate,
    GatePart,
    Judgement,
    Positive,
    Section,
    let_go,
    steps,
)
from carecontact.behaviours.touch_gently import GentleTouch


class TouchGate(Section):
    duration_s: Positive
    """Least time of uninterrupted contact [s]."""


class Touch(Behaviour[TouchGate]):
    gate = TouchGate
    versions: ClassVar = {"gates-v2": GentleTouch()}

    def judge(self, contact: Contact, gate: TouchGate, attempt: Attempt) -> Judgement:
        return Judgement(time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s), progress_met=True)

    def lost(self, contact: Contact, gate: TouchGate, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def requested(self, gate: TouchGate, asked: CommandedContact) -> str | None:
        return f"{asked.hold_s:.2f} s there" if asked.hold_s >= gate.duration_s else None

    def shortfall(self, contact: Contact, gate: TouchGate, result: Gate) -> str:
        return f"the longest hold was {result.longest_on_s:.2f} s of {gate.duration_s:g} s"

    def parts(self, contact: Contact, gate: TouchGate, result: Gate) -> list[GatePart]:
        return [result.time_part("Touched the named region or beside it without interruption", gate.duration_s)]


BEHAVIOURS.register("touch", Touch())
