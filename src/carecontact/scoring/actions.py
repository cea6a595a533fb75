"""The shipped actions: for each the rule by which a trial meets its gate, the sweeps of the gate's values, and the
words for a failure. A new action imports all that it needs from here (docs/evidence/extending.md)."""

from __future__ import annotations

from typing import ClassVar, TypeVar

from carecontact.protocol.gates import (
    ForceBand,
    Fraction,
    GentleTouchGate,
    Positive,
    PressGate,
    PushFromOnsetGate,
    PushGate,
    ScrubGate,
    ScrubPassesGate,
    Section,
    TouchGate,
)
from carecontact.scoring.behaviour import (
    BEHAVIOURS,
    Attempt,
    Behaviour,
    Gate,
    GatePart,
    Judgement,
    Sweep,
    exact_mm,
    hardest,
    in_mm,
    in_percent,
    let_go,
    middle_force,
    mm,
    reversals,
)
from carecontact.scoring.commanded import CommandedContact
from carecontact.scoring.contact import Contact, Mask, held_force, held_in_band, longest_run, steps
from carecontact.scoring.foam import LEAST_MMHG, PASSES, FoamCleaning
from carecontact.scoring.progress import Episode, wiping, wrist_from_onset
from carecontact.scoring.result import TrialScore

__all__ = [
    "BEHAVIOURS",
    "Attempt",
    "Behaviour",
    "CommandedContact",
    "Contact",
    "Episode",
    "ForceBand",
    "Fraction",
    "Gate",
    "GatePart",
    "Judgement",
    "Mask",
    "Positive",
    "Section",
    "Sweep",
    "TrialScore",
    "exact_mm",
    "hardest",
    "held_force",
    "held_in_band",
    "in_mm",
    "in_percent",
    "let_go",
    "longest_run",
    "middle_force",
    "mm",
    "reversals",
    "steps",
    "wiping",
    "wrist_from_onset",
]


# Touch: contact without interruption for a least time; in the exam, with a force that is felt and gentle.

T = TypeVar("T", bound=TouchGate | GentleTouchGate)


class Held(Behaviour[T]):
    """What both touches have in common: a hold of a least time."""

    def lost(self, contact: Contact, gate: T, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def reached(self, contact: Contact, gate: T, result: Gate) -> float:
        return result.longest_on_s / gate.duration_s

    def requested(self, gate: T, asked: CommandedContact) -> str | None:
        return f"{asked.hold_s:.2f} s there" if asked.hold_s >= gate.duration_s else None


class GentleTouch(Held[GentleTouchGate]):
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

    def gently_s(self, contact: Contact, gate: GentleTouchGate) -> float:
        return longest_run(held_in_band(contact, gate.least_n, gate.most_n)) * contact.dt_s

    def reached(self, contact: Contact, gate: GentleTouchGate, result: Gate) -> float:
        return self.gently_s(contact, gate) / gate.duration_s

    def shortfall(self, contact: Contact, gate: GentleTouchGate, result: Gate) -> str:
        held = self.gently_s(contact, gate)
        return (
            f"the longest hold with {gate.least_n:g} to {gate.most_n:g} N was {held:.2f} s of {gate.duration_s:g} s; "
            f"the tool's longest contact was {result.longest_on_s:.2f} s"
            f"{middle_force(held_force(contact)[contact.tool_on])}"
        )

    def parts(self, contact: Contact, gate: GentleTouchGate, result: Gate) -> list[GatePart]:
        held, least_s = self.gently_s(contact, gate), gate.duration_s
        name = f"Touched without interruption with {gate.least_n:g} to {gate.most_n:g} N"
        return [
            result.time_part("Touched the named region or beside it with the tool without interruption", least_s),
            GatePart(name=name, needed=f"{least_s:g} s", reached=f"{held:.2f} s", met=result.band_met),
        ]

    def progress(self, score: TrialScore) -> str:
        held = score.additional.get("gentle_hold@2")
        gently = "" if held is None else f", {held:.2f} s of it gently"
        return f"touched for {score.longest_on_s:.2f} s{gently}"


class Touch(Held[TouchGate]):
    gate = TouchGate
    sets: ClassVar = {"exam": GentleTouch()}

    def judge(self, contact: Contact, gate: TouchGate, attempt: Attempt) -> Judgement:
        return Judgement(time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s), progress_met=True)

    def shortfall(self, contact: Contact, gate: TouchGate, result: Gate) -> str:
        return f"the longest hold was {result.longest_on_s:.2f} s of {gate.duration_s:g} s"

    def parts(self, contact: Contact, gate: TouchGate, result: Gate) -> list[GatePart]:
        return [result.time_part("Touched the named region or beside it without interruption", gate.duration_s)]


BEHAVIOURS.register("touch", Touch())


# Push: the robot presses with a least force for a least time, and the wrist moves meanwhile. Under the exam's gates,
# the displacement counts from the beginning of the contact, and has an upper limit.

P = TypeVar("P", bound=PressGate)


class Press(Behaviour[P]):
    """What both pushes have in common: a hold with a least force, and a least distance that the wrist moves."""

    moves_the_person = True
    least_moved: ClassVar[str]
    """Field of the gate with that distance."""

    def holding(self, contact: Contact, gate: P) -> Mask:
        return contact.neighbourhood_on & (contact.neighbourhood_force >= gate.force_n)

    def lost(self, contact: Contact, gate: P, result: Gate) -> bool:
        return let_go(contact, self.holding(contact, gate), gate.duration_s / 2)

    def requested(self, gate: P, asked: CommandedContact) -> str | None:
        enough = asked.hold_s >= gate.duration_s and asked.way_m >= getattr(gate, self.least_moved)
        return f"{asked.hold_s:.2f} s and {mm(asked.way_m)} of way there" if enough else None

    def hold_part(self, contact: Contact, gate: P, result: Gate) -> GatePart:
        name = f"Pressed with at least {gate.force_n:g} N without interruption"
        return result.time_part(name, gate.duration_s, note=f" ({hardest(contact)})")


class PushFromOnset(Press[PushFromOnsetGate]):
    gate = PushFromOnsetGate
    least_moved = "least_wrist_m"
    by_tool = True
    harder = PushFromOnsetGate(force_n=3.0, duration_s=1.0, least_wrist_m=0.020, most_wrist_m=0.060)
    sweeps = (
        Sweep(name="push_force_n", field="force_n", values=(1.0, 3.0, 5.0), title="Push: force", unit="N"),
        in_mm(
            name="push_least_wrist_m",
            field="least_wrist_m",
            values=(0.010, 0.020, 0.030),
            title="Push: least distance that the wrist moved",
        ),
        in_mm(
            name="push_most_wrist_m",
            field="most_wrist_m",
            values=(0.060, 0.080, 0.100, 0.150),
            title="Push: most distance that the wrist moved",
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

    def reached(self, contact: Contact, gate: PushFromOnsetGate, result: Gate) -> float:
        moved = wrist_from_onset(contact)
        # Once it has moved too far, nothing makes up for it.
        held = result.longest_on_s / gate.duration_s
        return min(held, moved / gate.least_wrist_m) if moved <= gate.most_wrist_m else 0.0

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


class Push(Press[PushGate]):
    gate = PushGate
    least_moved = "wrist_displacement_m"
    sets: ClassVar = {"exam": PushFromOnset()}
    sweeps = (
        Sweep(name="push_force_n", field="force_n", values=(1.0, 3.0, 5.0), title="Push: force", unit="N"),
        in_mm(
            name="push_wrist_m", field="wrist_displacement_m", values=(0.010, 0.020, 0.030), title="Push: wrist moved"
        ),
    )
    needs = frozenset(("wrist",))

    def judge(self, contact: Contact, gate: PushGate, attempt: Attempt) -> Judgement:
        return Judgement(
            time_met=attempt.held_steps >= steps(gate.duration_s, contact.dt_s),
            progress_met=attempt.wrist_m >= gate.wrist_displacement_m,
        )

    def reached(self, contact: Contact, gate: PushGate, result: Gate) -> float:
        return min(result.longest_on_s / gate.duration_s, result.wrist_m / gate.wrist_displacement_m)

    def shortfall(self, contact: Contact, gate: PushGate, result: Gate) -> str:
        return (
            f"the longest hold was {result.longest_on_s:.2f} s of {gate.duration_s:g} s and the wrist moved "
            f"{mm(result.wrist_m)} of {mm(gate.wrist_displacement_m)}"
        )

    def parts(self, contact: Contact, gate: PushGate, result: Gate) -> list[GatePart]:
        return [
            self.hold_part(contact, gate, result),
            GatePart.least(
                "Distance the wrist moved while the arm is touched",
                mm(gate.wrist_displacement_m),
                exact_mm(result.wrist_m),
                result.progress_met,
            ),
        ]

    def progress(self, score: TrialScore) -> str:
        return f"wrist moved {mm(score.wrist_displacement_m)}, pressed for {score.longest_on_s:.2f} s"


BEHAVIOURS.register("push", Push())


# Scrub: the tool moves to and fro along the region and touches it for most of the time; in the exam, it passes a part
# of the region several times with a force that cleans and is gentle.


class ScrubPasses(Behaviour[ScrubPassesGate]):
    """The gate applies to the whole trial: a gap between two strokes does no harm, and the force of every stroke
    counts. Where the region has foam, the share of it that is cleaned takes the place of the length that is passed."""

    gate = ScrubPassesGate
    by_tool = True
    harder = ScrubPassesGate(least_n=1.0, most_n=8.0, passed_m=0.080, passes=3, band_share=0.8)
    sweeps = (
        in_mm(
            name="scrub_passed_m", field="passed_m", values=(0.040, 0.060, 0.080, 0.100), title="Scrub: length passed"
        ),
        Sweep(name="scrub_passes", field="passes", values=(1.0, 2.0, 3.0, 4.0), title="Scrub: passes", unit="1"),
        Sweep(name="scrub_least_n", field="least_n", values=(0.5, 1.0, 2.0), title="Scrub: least force", unit="N"),
        Sweep(name="scrub_most_n", field="most_n", values=(6.0, 8.0, 10.0, 15.0), title="Scrub: most force", unit="N"),
        in_percent(
            name="scrub_band_share", field="band_share", values=(0.5, 0.7, 0.9), title="Scrub: time in the band"
        ),
    )

    def judge(self, contact: Contact, gate: ScrubPassesGate, attempt: Attempt) -> Judgement:
        found = wiping(contact)
        share = found.share_in_band(gate.least_n, gate.most_n)
        gentle = share is not None and share >= gate.band_share
        if (foam := FoamCleaning.of(contact)) is not None:
            return Judgement(time_met=True, progress_met=foam.met, band_met=gentle)
        passed, firmly = (found.passed_m(gate.passes, least_n) >= gate.passed_m for least_n in (0.0, gate.least_n))
        return Judgement(time_met=True, progress_met=passed, band_met=gentle and firmly)

    def reached(self, contact: Contact, gate: ScrubPassesGate, result: Gate) -> float:
        found = wiping(contact)
        share = found.share_in_band(gate.least_n, gate.most_n) or 0.0
        if (foam := FoamCleaning.of(contact)) is not None:
            return min(foam.share / foam.least, 1.0, share / max(gate.band_share, share, 1e-9))
        passed = [found.passed_m(times, gate.least_n) / gate.passed_m for times in range(1, gate.passes + 1)]
        return min(sum(min(one, 1.0) for one in passed) / gate.passes, share / max(gate.band_share, share, 1e-9))

    def requested(self, gate: ScrubPassesGate, asked: CommandedContact) -> str | None:
        enough = asked.extent_m >= gate.passed_m and asked.reversals >= gate.passes - 1
        return f"{mm(asked.extent_m)} of extent and {reversals(asked.reversals)} there" if enough else None

    def shortfall(self, contact: Contact, gate: ScrubPassesGate, result: Gate) -> str:
        found = wiping(contact)
        share = found.share_in_band(gate.least_n, gate.most_n)
        slid = (
            "the tool never slid over the skin in contact"
            if share is None
            else f"{share:.0%} of the sliding was with {gate.least_n:g} to {gate.most_n:g} N, "
            f"{gate.band_share:.0%} needed"
        )
        middle = middle_force(found.force[1:][found.moving])
        if (foam := FoamCleaning.of(contact)) is not None:
            return f"{foam}, and {slid}{middle}"
        return (
            f"{mm(found.passed_m(gate.passes, gate.least_n))} of {mm(gate.passed_m)} were passed {gate.passes:g} times "
            f"with at least {gate.least_n:g} N ({mm(found.passed_m(gate.passes, 0.0))} with any force), and {slid}"
            f"{middle}"
        )

    def parts(self, contact: Contact, gate: ScrubPassesGate, result: Gate) -> list[GatePart]:
        found = wiping(contact)
        passed, firmly = found.passed_m(gate.passes, 0.0), found.passed_m(gate.passes, gate.least_n)
        share = found.share_in_band(gate.least_n, gate.most_n)
        name = f"Share of the sliding with {gate.least_n:g} to {gate.most_n:g} N"
        reached, gentle = (
            ("the tool never slid", False) if share is None else (f"{share:.1%}", share >= gate.band_share)
        )
        in_band = GatePart.least(name, f"{gate.band_share:.0%}", reached, gentle)
        if (foam := FoamCleaning.of(contact)) is not None:
            name = f"Share of the foam that the tool passed {PASSES} times with at least {LEAST_MMHG:g} mmHg"
            return [GatePart.least(name, f"{foam.least:.0%}", f"{foam.share:.1%}", foam.met), in_band]
        name, needed = f"Length of the region passed {gate.passes:g} times with", mm(gate.passed_m)
        return [
            GatePart.least(f"{name} any force", needed, exact_mm(passed), result.progress_met),
            GatePart.least(f"{name} at least {gate.least_n:g} N", needed, exact_mm(firmly), firmly >= gate.passed_m),
            in_band,
        ]

    def progress(self, score: TrialScore) -> str:
        passed, share = (score.additional.get(name) for name in ("axis_passed@2", "gentle_share@2"))
        cleaned = score.additional.get("foam_cleaned@1")
        done = [f"{mm(passed)} passed three times"] if passed is not None else []
        done = done if cleaned is None else [f"{cleaned:.0%} of the foam cleaned"]
        done += [f"{share:.0%} of the sliding gently"] if share is not None else []
        return ", ".join(done) or f"stroke {mm(score.stroke_m)}"


class Scrub(Behaviour[ScrubGate]):
    """The gate applies to one contact episode and not to one hold, so that a brief gap does not fail the trial."""

    gate = ScrubGate
    sets: ClassVar = {"exam": ScrubPasses()}
    sweeps = (
        in_mm(name="scrub_stroke_m", field="stroke_m", values=(0.100, 0.200), title="Scrub: stroke"),
        in_mm(name="scrub_extent_m", field="extent_m", values=(0.030, 0.050, 0.060), title="Scrub: extent"),
    )
    needs = frozenset(("episodes",))

    def passes(self, gate: ScrubGate, episode: Episode) -> bool:
        return _scrubbed(gate, episode) and episode.on_share >= gate.on_share

    def judge(self, contact: Contact, gate: ScrubGate, attempt: Attempt) -> Judgement:
        best = attempt.best
        return Judgement(
            time_met=best is not None and best.on_share >= gate.on_share,
            progress_met=best is not None and _scrubbed(gate, best),
        )

    def reached(self, contact: Contact, gate: ScrubGate, result: Gate) -> float:
        if (best := result.best) is None:
            return 0.0
        turns = best.reversals / gate.reversals if gate.reversals else 1.0
        parts = (best.stroke_m / gate.stroke_m, best.extent_m / gate.extent_m, turns)
        # Their mean, because the least of them stays 0 until the tool turns.
        return (float(best.on_share >= gate.on_share) + sum(min(part, 1.0) for part in parts)) / 4

    def lost(self, contact: Contact, gate: ScrubGate, result: Gate) -> bool:
        """Whether contact was lost; for this action, half of the required share of contact counts as a good part of the
        time."""
        if result.best is None:
            return False
        target_on = contact.on[result.best.start : result.best.stop, contact.target]
        return bool(target_on.mean() >= gate.on_share / 2)

    def requested(self, gate: ScrubGate, asked: CommandedContact) -> str | None:
        if not _scrubbed(gate, asked):
            return None
        return f"{mm(asked.stroke_m)} stroke and {mm(asked.extent_m)} extent there"

    def shortfall(self, contact: Contact, gate: ScrubGate, result: Gate) -> str:
        best = result.best
        if best is None:
            return "there was no contact episode to judge"
        return (
            f"in the best contact, the tool moved {mm(best.stroke_m)} along the skin ({mm(gate.stroke_m)} needed), "
            f"covered {mm(best.extent_m)} ({mm(gate.extent_m)}), had {reversals(best.reversals)} "
            f"({gate.reversals}), and touched for {best.on_share:.0%} of the time ({gate.on_share:.0%})"
        )

    def parts(self, contact: Contact, gate: ScrubGate, result: Gate) -> list[GatePart]:
        best, any_contact = result.best or NO_EPISODE, result.best is not None
        share, stroke, extent, turns = best.on_share, best.stroke_m, best.extent_m, best.reversals
        rows = (
            (
                "Share of the contact's time that the tool touches",
                gate.on_share,
                share,
                "{:.0%}".format,
                "{:.1%}".format,
            ),
            ("Distance the tool moved along the skin", gate.stroke_m, stroke, mm, exact_mm),
            ("Length of the region that it covers", gate.extent_m, extent, mm, exact_mm),
            ("Turns of the tool", gate.reversals, turns, str, str),
        )
        return [
            GatePart.least(name, whole(least), exact(reached), any_contact and reached >= least)
            for name, least, reached, whole, exact in rows
        ]

    def progress(self, score: TrialScore) -> str:
        return f"stroke {mm(score.stroke_m)}, extent {mm(score.extent_m)}, {reversals(score.reversals)}"


NO_EPISODE = Episode(start=0, stop=0, on_share=0.0, stroke_m=0.0, extent_m=0.0, reversals=0)


def _scrubbed(gate: ScrubGate, found: Episode | CommandedContact) -> bool:
    return found.stroke_m >= gate.stroke_m and found.extent_m >= gate.extent_m and found.reversals >= gate.reversals


BEHAVIOURS.register("scrub", Scrub())
