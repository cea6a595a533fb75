"""Hold: steady contact within a band of force."""

from carecontact.scoring.actions import (
    Attempt,
    Behaviour,
    CommandedContact,
    Contact,
    Gate,
    Judgement,
    Mask,
    Positive,
    Section,
    Sweep,
    let_go,
    steps,
)


class HoldGate(Section):
    low_n: Positive
    high_n: Positive
    duration_s: Positive


class Hold(Behaviour[HoldGate]):
    gate = HoldGate
    sweeps = (Sweep(name="hold_high_n", field="high_n", values=(4.0, 6.0, 8.0), title="Hold: largest force", unit="N"),)

    def holding(self, contact: Contact, gate: HoldGate) -> Mask:
        force = contact.neighbourhood_force
        return contact.neighbourhood_on & (force >= gate.low_n) & (force <= gate.high_n)

    def judge(self, contact: Contact, gate: HoldGate, attempt: Attempt) -> Judgement:
        return Judgement(time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s), progress_met=True)

    def lost(self, contact: Contact, gate: HoldGate, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def requested(self, gate: HoldGate, asked: CommandedContact) -> str | None:
        return f"{asked.hold_s:.2f} s there" if asked.hold_s >= gate.duration_s else None

    def shortfall(self, contact: Contact, gate: HoldGate, result: Gate) -> str:
        band = f"between {gate.low_n:g} and {gate.high_n:g} N"
        return f"the longest hold {band} was {result.longest_on_s:.2f} s of {gate.duration_s:g} s"


HOLD = Hold()
