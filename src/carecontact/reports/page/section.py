"""What a section of the page is, and what it may use. Every module of ``sections`` adds one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from carecontact.contract.protocol import Protocol
from carecontact.errors import counted
from carecontact.recording.schema import Header, Recording
from carecontact.registry import Registry
from carecontact.reports.compare.baselines import Baselines
from carecontact.scoring.result import TrialScore

Kept = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Page:
    """One run, as the sections of its page see it."""

    folder: Path
    scores: Sequence[TrialScore]
    """All of them, by task and seed."""
    judged: Sequence[TrialScore]
    """The scores of the trials that have a verdict: all but those in which the harness failed."""
    shown: Sequence[TrialScore]
    """The scores of ``judged`` that the page shows one by one."""
    skipped: Mapping[str, str]
    """File -> why it has no score."""
    unjudged: Mapping[str, str]
    """Planned trial -> why it has no verdict."""
    baselines: Baselines | None
    """Blind baselines that stand beside the run."""
    lost_baselines: Mapping[str, str]
    """Baseline that stood beside the run -> why it cannot any more."""
    kept_scores: str = ""
    """Why the scores that are kept of the shipped policies do not stand beside the run; empty where they do."""
    links: Mapping[str, str] = field(default_factory=dict[str, str])
    """File in the run's folder that the page may link -> its address; those that are there."""
    headers: dict[str, Header] = field(default_factory=dict[str, Header])
    """Trial -> header of its recording, for those of ``shown`` that could be read; hardest contact of a task first."""
    unread: dict[str, str] = field(default_factory=dict[str, str])
    """The others of ``shown`` -> why not."""
    kept: dict[str, Kept] = field(default_factory=dict[str, Kept])
    """Section -> what it kept of the recordings."""

    @property
    def protocol(self) -> Protocol | None:
        """None where no recording could be read."""
        return next((header.spec.protocol for header in self.headers.values()), None)

    @property
    def trials(self) -> str:
        """``7 trials``, or ``15 trials with a verdict, of 18 planned``."""
        trials = counted(len(self.judged), "trial")
        return (
            f"{trials} with a verdict, of {len(self.judged) + len(self.unjudged)} planned" if self.unjudged else trials
        )

    @property
    def gamma(self) -> float | None:
        """The protocol's discount of the pain limits."""
        return None if self.protocol is None else self.protocol.limits.gamma


Data = Callable[[Page], Mapping[str, Any] | None]
Keep = Callable[[TrialScore, Recording, Kept], None]


@dataclass(frozen=True, kw_only=True)
class Section:
    name: str
    order: int
    """Place on the page, lowest first."""
    template: str
    """Jinja, escaped by itself; sees what ``data`` returns."""
    data: Data
    """None: the page goes without this section."""
    keep: Keep | None = None
    """Sees each recording of ``Page.shown`` once, hardest contact of a task first, and puts what the section needs of
    it into the section's own dictionary. A RecordingError makes the trial one of ``Page.unread``."""


SECTIONS: Registry[Section] = Registry("section", scan="carecontact.reports.page.sections")


def section(name: str, *, order: int, template: str, keep: Keep | None = None) -> Callable[[Data], Data]:
    """Register a function of the page as a section; ``Section`` explains the arguments."""

    def register(data: Data) -> Data:
        SECTIONS.register(name, Section(name=name, order=order, template=template, data=data, keep=keep))
        return data

    return register


def sections_in_order() -> list[Section]:
    return sorted(SECTIONS.values(), key=lambda row: (row.order, row.name))
