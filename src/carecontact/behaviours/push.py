"""Push: the robot presses with a least force for a least time, and the wrist moves meanwhile."""

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
    Mask,
    Positive,
    Section,
    Sweep,
    TrialScore,
    exact_mm,
    hardest,
    let_go,
    mm,
    steps,
)
from carecontact.behaviours.push_from_onset import PushFromOnset


class PushGate(Section):
    force_n: Positive
    """Least force, summed over the named region's segment and its neighbours, during the whole hold [N]."""
    duration_s: Positive
    wrist_displacement_m: Positive
    """Least horizontal displacement of the wrist from where it rested before the trial [m]."""


class Push(Behaviour[PushGate]):
    gate = PushGate
    versions: ClassVar = {"gates-v2": PushFromOnset()}
    sweeps = (
        Sweep(name="push_force_n", field="force_n", values=(1.0, 3.0, 5.0), title="Push: force", unit="N"),
        Sweep(
            name="push_wrist_m",
            field="wrist_displacement_m",
            values=(0.010, 0.020, 0.030),
            title="Push: wrist moved",
            unit="mm",
            factor=1000.0,
        ),
    )
    needs = frozenset(("wrist",))
    moves_the_person = True

    def holding(self, contact: Contact, gate: PushGate) -> Mask:
        return contact.neighbourhood_on & (contact.neighbourhood_force >= gate.force_n)

    def judge(self, contact: Contact, gate: PushGate, attempt: Attempt) -> Judgement:
        return Judgement(
            time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s),
            progress_met=attempt.wrist_m >= gate.wrist_displacement_m,
        )

    def lost(self, contact: Contact, gate: PushGate, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def requested(self, gate: PushGate, asked: CommandedContact) -> str | None:
        enough = asked.hold_s >= gate.duration_s and asked.way_m >= gate.wrist_displacement_m
        return f"{asked.hold_s:.2f} s and {mm(asked.way_m)} of way there" if enough else None

    def shortfall(self, contact: Contact, gate: PushGate, result: Gate) -> str:
        return (
            f"the longest hold was {result.longest_on_s:.2f} s of {gate.duration_s:g} s and the wrist moved "
            f"{mm(result.wrist_m)} of {mm(gate.wrist_displacement_m)}"
        )

    def parts(self, contact: Contact, gate: PushGate, result: Gate) -> list[GatePart]:
        pressed = f"Pressed with at least {gate.force_n:g} N without interruption"
        return [
            result.time_part(pressed, gate.duration_s, note=f" ({hardest(contact)})"),
            GatePart(
                name="Distance the wrist moved while the arm is touched",
                needed=f"at least {mm(gate.wrist_displacement_m)}",
                reached=exact_mm(result.wrist_m),
                met=result.progress_met,
            ),
        ]

    def progress(self, score: TrialScore) -> str:
        return f"wrist moved {mm(score.wrist_displacement_m)}, pressed for {score.longest_on_s:.2f} s"


BEHAVIOURS.register("push", Push())
