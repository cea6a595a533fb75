"""Scrub under gates-v2: the tool passes a part of the region several times, with a force that cleans and is gentle."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from carecontact.behaviours import (
    Attempt,
    Behaviour,
    CommandedContact,
    Contact,
    ForceBand,
    Fraction,
    Gate,
    GatePart,
    Judgement,
    Positive,
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
        passed, share = (score.additional.get(name) for name in ("axis_passed@1", "gentle_share@1"))
        told = [f"{mm(passed)} passed three times"] if passed is not None else []
        told += [f"{share:.0%} of the sliding gently"] if share is not None else []
        return ", ".join(told) or f"stroke {mm(score.stroke_m)}"
