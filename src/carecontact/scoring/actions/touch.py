"""Touch: contact without interruption for a least time; in the exam, with a force that is felt and gentle."""

from __future__ import annotations

from typing import ClassVar

from carecontact.scoring.actions import (
    BEHAVIOURS,
    Attempt,
    Behaviour,
    CommandedContact,
    Contact,
    ForceBand,
    Gate,
    GatePart,
    Judgement,
    Mask,
    Positive,
    Section,
    Sweep,
    TrialScore,
    held_force,
    held_in_band,
    let_go,
    longest_run,
    middle_force,
    steps,
)


class GentleTouchGate(ForceBand):
    """docs/scoring.md has the reasons and sources of the values in the shipped protocols."""

    duration_s: Positive
    """Least time of uninterrupted contact with the force in the band [s]."""


class GentleTouch(Behaviour[GentleTouchGate]):
    gate = GentleTouchGate
    by_tool = True
    harder = GentleTouchGate(least_n=1.0, most_n=4.0, duration_s=1.5)
    sweeps = (
        Sweep(name="touch_least_n", field="least_n", values=(0.5, 1.0, 2.0), title="Touch: least force", unit="N"),
        Sweep(name="touch_most_n", field="most_n", values=(4.0, 6.0, 8.0, 12.0), title="Touch: most force", unit="N"),
        Sweep(name="touch_duration_s", field="duration_s", values=(0.5, 1.0, 1.5, 2.0), title="Touch: hold", unit="s"),
    )

    def judge(self, contact: Contact, gate: GentleTouchGate, attempt: Attempt) -> Judgement:
        least = steps(gate.duration_s, contact.dt_s)
        return Judgement(
            time_met=attempt.held_steps >= least,
            progress_met=True,
            band_met=longest_run(held_in_band(contact, gate.least_n, gate.most_n)) >= least,
        )

    def holding(self, contact: Contact, gate: GentleTouchGate) -> Mask:
        return contact.tool_on

    def lost(self, contact: Contact, gate: GentleTouchGate, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def requested(self, gate: GentleTouchGate, asked: CommandedContact) -> str | None:
        return f"{asked.hold_s:.2f} s there" if asked.hold_s >= gate.duration_s else None

    def shortfall(self, contact: Contact, gate: GentleTouchGate, result: Gate) -> str:
        held = longest_run(held_in_band(contact, gate.least_n, gate.most_n)) * contact.dt_s
        return (
            f"the longest hold with {gate.least_n:g} to {gate.most_n:g} N was {held:.2f} s of {gate.duration_s:g} s; "
            f"the tool's longest contact was {result.longest_on_s:.2f} s"
            f"{middle_force(held_force(contact)[contact.tool_on])}"
        )

    def parts(self, contact: Contact, gate: GentleTouchGate, result: Gate) -> list[GatePart]:
        held = longest_run(held_in_band(contact, gate.least_n, gate.most_n)) * contact.dt_s
        return [
            result.time_part(
                "Touched the named region or beside it with the tool without interruption", gate.duration_s
            ),
            GatePart(
                name=f"Touched without interruption with {gate.least_n:g} to {gate.most_n:g} N",
                needed=f"{gate.duration_s:g} s",
                reached=f"{held:.2f} s",
                met=result.band_met,
            ),
        ]

    def progress(self, score: TrialScore) -> str:
        held = score.additional.get("gentle_hold@2")
        gently = "" if held is None else f", {held:.2f} s of it gently"
        return f"touched for {score.longest_on_s:.2f} s{gently}"


class TouchGate(Section):
    duration_s: Positive
    """Least time of uninterrupted contact [s]."""


class Touch(Behaviour[TouchGate]):
    gate = TouchGate
    sets: ClassVar = {"exam": GentleTouch()}

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
