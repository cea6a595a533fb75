"""Scrub: the tool moves to and fro along the region and touches it for most of the time; in the exam, it passes a part
of the region several times with a force that cleans and is gentle."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from carecontact.scoring.actions import (
    BEHAVIOURS,
    Attempt,
    Behaviour,
    CommandedContact,
    Contact,
    Episode,
    ForceBand,
    Fraction,
    Gate,
    GatePart,
    Judgement,
    Positive,
    Section,
    Sweep,
    TrialScore,
    exact_mm,
    middle_force,
    mm,
    reversals,
    wiping,
)


class ScrubPassesGate(ForceBand):
    """docs/scoring.md has the reasons and sources of the values in the shipped protocols."""

    passed_m: Positive
    """Least length of the part of the region's axis that is passed ``passes`` times with at least ``least_n`` [m]."""
    passes: Annotated[int, Field(ge=1)]
    band_share: Fraction
    """Least share of the sliding time in which the force is in the band."""


class ScrubPasses(Behaviour[ScrubPassesGate]):
    """The gate applies to the whole trial: a gap between two strokes does no harm, and the force of every stroke
    counts."""

    gate = ScrubPassesGate
    by_tool = True
    harder = ScrubPassesGate(least_n=1.0, most_n=8.0, passed_m=0.080, passes=3, band_share=0.8)
    sweeps = (
        Sweep(
            name="scrub_passed_m",
            field="passed_m",
            values=(0.040, 0.060, 0.080, 0.100),
            title="Scrub: length passed",
            unit="mm",
            factor=1000.0,
        ),
        Sweep(name="scrub_passes", field="passes", values=(1.0, 2.0, 3.0, 4.0), title="Scrub: passes", unit="1"),
        Sweep(name="scrub_least_n", field="least_n", values=(0.5, 1.0, 2.0), title="Scrub: least force", unit="N"),
        Sweep(name="scrub_most_n", field="most_n", values=(6.0, 8.0, 10.0, 15.0), title="Scrub: most force", unit="N"),
        Sweep(
            name="scrub_band_share",
            field="band_share",
            values=(0.5, 0.7, 0.9),
            title="Scrub: time in the band",
            unit="%",
            factor=100.0,
        ),
    )

    def judge(self, contact: Contact, gate: ScrubPassesGate, attempt: Attempt) -> Judgement:
        found = wiping(contact)
        share = found.share_in_band(gate.least_n, gate.most_n)
        return Judgement(
            time_met=True,
            progress_met=found.passed_m(gate.passes, 0.0) >= gate.passed_m,
            band_met=share is not None
            and share >= gate.band_share
            and found.passed_m(gate.passes, gate.least_n) >= gate.passed_m,
        )

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
        return (
            f"{mm(found.passed_m(gate.passes, gate.least_n))} of {mm(gate.passed_m)} were passed {gate.passes:g} times "
            f"with at least {gate.least_n:g} N ({mm(found.passed_m(gate.passes, 0.0))} with any force), and {slid}"
            f"{middle_force(found.force[1:][found.moving])}"
        )

    def parts(self, contact: Contact, gate: ScrubPassesGate, result: Gate) -> list[GatePart]:
        found = wiping(contact)
        passed, firmly = found.passed_m(gate.passes, 0.0), found.passed_m(gate.passes, gate.least_n)
        share = found.share_in_band(gate.least_n, gate.most_n)
        length = f"Length of the region passed {gate.passes:g} times"
        rows = (
            (f"{length} with any force", mm(gate.passed_m), exact_mm(passed), result.progress_met),
            (f"{length} with at least {gate.least_n:g} N", mm(gate.passed_m), exact_mm(firmly),
             firmly >= gate.passed_m),
            (f"Share of the sliding with {gate.least_n:g} to {gate.most_n:g} N", f"{gate.band_share:.0%}",
             "the tool never slid" if share is None else f"{share:.1%}",
             share is not None and share >= gate.band_share),
        )  # fmt: skip
        return [GatePart(name=name, needed=f"at least {need}", reached=had, met=met) for name, need, had, met in rows]

    def progress(self, score: TrialScore) -> str:
        passed, share = (score.additional.get(name) for name in ("axis_passed@2", "gentle_share@2"))
        told = [f"{mm(passed)} passed three times"] if passed is not None else []
        told += [f"{share:.0%} of the sliding gently"] if share is not None else []
        return ", ".join(told) or f"stroke {mm(score.stroke_m)}"


class ScrubGate(Section):
    on_share: Fraction
    """Least share of an episode's time that is in contact."""
    stroke_m: Positive
    """Least length of the tool's path over the skin while in contact [m]."""
    extent_m: Positive
    """Least length of the part of the region's axis that this path covers [m]."""
    reversals: int


class Scrub(Behaviour[ScrubGate]):
    """The gate applies to one contact episode and not to one hold, so that a brief gap does not fail the trial."""

    gate = ScrubGate
    sets: ClassVar = {"exam": ScrubPasses()}
    sweeps = (
        Sweep(
            name="scrub_stroke_m",
            field="stroke_m",
            values=(0.100, 0.200),
            title="Scrub: stroke",
            unit="mm",
            factor=1000.0,
        ),
        Sweep(
            name="scrub_extent_m",
            field="extent_m",
            values=(0.030, 0.050, 0.060),
            title="Scrub: extent",
            unit="mm",
            factor=1000.0,
        ),
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

    def lost(self, contact: Contact, gate: ScrubGate, result: Gate) -> bool:
        """Whether contact was lost; for this action, half of the required share of contact counts as a good part of the
        time."""
        if result.best is None:
            return False
        target_on = contact.on[result.best.start : result.best.stop, contact.target]
        return bool(target_on.mean() >= gate.on_share / 2)

    def requested(self, gate: ScrubGate, asked: CommandedContact) -> str | None:
        enough = (
            asked.stroke_m >= gate.stroke_m and asked.extent_m >= gate.extent_m and asked.reversals >= gate.reversals
        )
        return f"{mm(asked.stroke_m)} stroke and {mm(asked.extent_m)} extent there" if enough else None

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
        best = result.best
        share, stroke, extent, turns = (
            (0.0, 0.0, 0.0, 0) if best is None else (best.on_share, best.stroke_m, best.extent_m, best.reversals)
        )
        rows = (
            ("Share of the contact's time that the tool touches", f"{gate.on_share:.0%}", f"{share:.1%}",
             best is not None and share >= gate.on_share),
            ("Distance the tool moved along the skin", mm(gate.stroke_m), exact_mm(stroke), stroke >= gate.stroke_m),
            ("Length of the region that it covers", mm(gate.extent_m), exact_mm(extent), extent >= gate.extent_m),
            ("Turns of the tool", str(gate.reversals), str(turns), best is not None and turns >= gate.reversals),
        )  # fmt: skip
        return [GatePart(name=name, needed=f"at least {need}", reached=had, met=met) for name, need, had, met in rows]

    def progress(self, score: TrialScore) -> str:
        return f"stroke {mm(score.stroke_m)}, extent {mm(score.extent_m)}, {reversals(score.reversals)}"


def _scrubbed(gate: ScrubGate, episode: Episode) -> bool:
    return (
        episode.stroke_m >= gate.stroke_m and episode.extent_m >= gate.extent_m and episode.reversals >= gate.reversals
    )


BEHAVIOURS.register("scrub", Scrub())
