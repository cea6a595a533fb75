"""Scrub: the tool moves to and fro along the region and is in contact for most of the time."""

from __future__ import annotations

from typing import ClassVar

from carecontact.behaviours import (
    BEHAVIOURS,
    Attempt,
    Behaviour,
    CommandedContact,
    Contact,
    Episode,
    Fraction,
    Gate,
    GatePart,
    Judgement,
    Positive,
    Section,
    Sweep,
    TrialScore,
    exact_mm,
    mm,
    reversals,
)
from carecontact.behaviours.scrub_passes import ScrubPasses


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
    versions: ClassVar = {"gates-v2": ScrubPasses()}
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
