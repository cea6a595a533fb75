"""Push: the robot presses with a least force for a least time, and the wrist moves meanwhile.

Under the exam's gates, the displacement counts from the beginning of the contact, and has an upper limit."""

from __future__ import annotations

from typing import ClassVar, Self, TypeVar

from pydantic import model_validator

from carecontact.scoring.actions import (
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
    wrist_from_onset,
)


class PressGate(Section):
    force_n: Positive
    """Least force, summed over the named region's segment and its neighbours, during the whole hold [N]."""
    duration_s: Positive


G = TypeVar("G", bound=PressGate)


class Press(Behaviour[G]):
    """What both pushes have in common: a hold with a least force."""

    moves_the_person = True

    def holding(self, contact: Contact, gate: G) -> Mask:
        return contact.neighbourhood_on & (contact.neighbourhood_force >= gate.force_n)

    def lost(self, contact: Contact, gate: G, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def hold_part(self, contact: Contact, gate: G, result: Gate) -> GatePart:
        name = f"Pressed with at least {gate.force_n:g} N without interruption"
        return result.time_part(name, gate.duration_s, note=f" ({hardest(contact)})")


class PushFromOnsetGate(PressGate):
    """docs/scoring.md has the reasons and sources of the values in the shipped protocols."""

    least_wrist_m: Positive
    """Least horizontal displacement of the wrist from where it was when the contact episode began [m]."""
    most_wrist_m: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.least_wrist_m >= self.most_wrist_m:
            raise ValueError(f"least_wrist_m {self.least_wrist_m:g} has to be below most_wrist_m {self.most_wrist_m:g}")
        return self


class PushFromOnset(Press[PushFromOnsetGate]):
    gate = PushFromOnsetGate
    by_tool = True
    harder = PushFromOnsetGate(force_n=3.0, duration_s=1.0, least_wrist_m=0.020, most_wrist_m=0.060)
    sweeps = (
        Sweep(name="push_force_n", field="force_n", values=(1.0, 3.0, 5.0), title="Push: force", unit="N"),
        Sweep(
            name="push_least_wrist_m",
            field="least_wrist_m",
            values=(0.010, 0.020, 0.030),
            title="Push: least distance that the wrist moved",
            unit="mm",
            factor=1000.0,
        ),
        Sweep(
            name="push_most_wrist_m",
            field="most_wrist_m",
            values=(0.060, 0.080, 0.100, 0.150),
            title="Push: most distance that the wrist moved",
            unit="mm",
            factor=1000.0,
        ),
    )

    def holding(self, contact: Contact, gate: PushFromOnsetGate) -> Mask:
        return super().holding(contact.of_tool, gate)

    def judge(self, contact: Contact, gate: PushFromOnsetGate, attempt: Attempt) -> Judgement:
        moved = wrist_from_onset(contact)
        return Judgement(
            time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s),
            progress_met=moved >= gate.least_wrist_m,
            band_met=moved <= gate.most_wrist_m,
        )

    def requested(self, gate: PushFromOnsetGate, asked: CommandedContact) -> str | None:
        enough = asked.hold_s >= gate.duration_s and asked.way_m >= gate.least_wrist_m
        return f"{asked.hold_s:.2f} s and {mm(asked.way_m)} of way there" if enough else None

    def shortfall(self, contact: Contact, gate: PushFromOnsetGate, result: Gate) -> str:
        return (
            f"the longest hold was {result.longest_on_s:.2f} s of {gate.duration_s:g} s and, from where the contact "
            f"began, the wrist moved {mm(wrist_from_onset(contact))}, where {mm(gate.least_wrist_m)} to "
            f"{mm(gate.most_wrist_m)} are required"
        )

    def parts(self, contact: Contact, gate: PushFromOnsetGate, result: Gate) -> list[GatePart]:
        return [
            self.hold_part(contact, gate, result),
            GatePart(
                name="Distance the wrist moved from where it was when the contact began",
                needed=f"{mm(gate.least_wrist_m)} to {mm(gate.most_wrist_m)}",
                reached=exact_mm(wrist_from_onset(contact)),
                met=result.progress_met and result.band_met,
            ),
        ]

    def progress(self, score: TrialScore) -> str:
        moved = score.additional.get("wrist_from_onset@2")
        way = "" if moved is None else f"wrist moved {mm(moved)} from where the contact began, "
        return f"{way}pressed for {score.longest_on_s:.2f} s"


class PushGate(PressGate):
    wrist_displacement_m: Positive
    """Least horizontal displacement of the wrist from where it rested before the trial [m]."""


class Push(Press[PushGate]):
    gate = PushGate
    sets: ClassVar = {"exam": PushFromOnset()}
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

    def judge(self, contact: Contact, gate: PushGate, attempt: Attempt) -> Judgement:
        return Judgement(
            time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s),
            progress_met=attempt.wrist_m >= gate.wrist_displacement_m,
        )

    def requested(self, gate: PushGate, asked: CommandedContact) -> str | None:
        enough = asked.hold_s >= gate.duration_s and asked.way_m >= gate.wrist_displacement_m
        return f"{asked.hold_s:.2f} s and {mm(asked.way_m)} of way there" if enough else None

    def shortfall(self, contact: Contact, gate: PushGate, result: Gate) -> str:
        return (
            f"the longest hold was {result.longest_on_s:.2f} s of {gate.duration_s:g} s and the wrist moved "
            f"{mm(result.wrist_m)} of {mm(gate.wrist_displacement_m)}"
        )

    def parts(self, contact: Contact, gate: PushGate, result: Gate) -> list[GatePart]:
        return [
            self.hold_part(contact, gate, result),
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
