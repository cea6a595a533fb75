"""The page of a run: what a section is and what it may use, and how the page is made of all sections."""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from carecontact import __version__
from carecontact.errors import RecordingError, counted
from carecontact.protocol.lock import frozen_state
from carecontact.protocol.protocol import Protocol
from carecontact.recording.file import replace_file
from carecontact.recording.schema import Header, Recording
from carecontact.registry import Registry
from carecontact.report.baselines import Baselines, Passed
from carecontact.report.links import link_report
from carecontact.report.tables import sorted_scores
from carecontact.report.words import short_names
from carecontact.runs.pooling import check_one_run, judged, unjudged
from carecontact.scoring.result import TrialScore

# Which trials of a long run a page shows one by one.

FULL_DETAIL = 21
"""Up to this many trials every one is shown in detail."""
FAILURES_SHOWN = 14
"""Beyond FULL_DETAIL: one trial a task, and this many of those that did not pass."""


def trials_in_detail(ordered: Sequence[TrialScore]) -> list[TrialScore]:
    """Return all trials of a short run; of a longer one, each task's first and FAILURES_SHOWN that did not pass.

    The failures are taken in turn from all tasks, so that one bad task does not crowd out the others.
    """
    if len(ordered) <= FULL_DETAIL:
        return list(ordered)
    first = {s.task_id: s.trial_id for s in reversed(ordered)}
    chosen = set(first.values())
    rank: Counter[str] = Counter()
    queue: list[tuple[int, str, str]] = []
    for score in ordered:
        if not score.safety_gated and score.trial_id not in chosen:
            queue.append((rank[score.task_id], score.task_id, score.trial_id))
            rank[score.task_id] += 1
    chosen |= {trial_id for _, _, trial_id in sorted(queue)[:FAILURES_SHOWN]}
    return [s for s in ordered if s.trial_id in chosen]


def hardest_first(chosen: Sequence[TrialScore]) -> list[TrialScore]:
    """Hardest contact of each task first: its frame is the one shown."""
    return sorted(chosen, key=lambda s: (s.task_id, -(s.c1_peak_force_n or 0.0), s.seed))


# The script of the page: it sorts and filters the table of trials, which is whole without it.


@cache
def table_script() -> str:
    return (files("carecontact.report") / "templates" / "trials.js").read_text(encoding="utf-8")


def script_source() -> str:
    """Return what the page's Content-Security-Policy allows: this script and no other."""
    digest = hashlib.sha256(table_script().encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


# What a section of the page is, and what it may use. Every module of ``sections`` adds one.

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


SECTIONS: Registry[Section] = Registry("section", scan="carecontact.report.sections")


def section(name: str, *, order: int, template: str, keep: Keep | None = None) -> Callable[[Data], Data]:
    """Register a function of the page as a section; ``Section`` explains the arguments."""

    def register(data: Data) -> Data:
        SECTIONS.register(name, Section(name=name, order=order, template=template, data=data, keep=keep))
        return data

    return register


def sections_in_order() -> list[Section]:
    return sorted(SECTIONS.values(), key=lambda row: (row.order, row.name))


# How the page names the protocol of its run.


def protocol_of(page: Page) -> str | None:
    """Return the title, and whether the protocol differs from what was frozen under its id; None without trials."""
    if not page.scores:
        return None
    title = page.scores[0].protocol_title
    changed = any(frozen_state(header.spec.protocol).startswith("not the frozen") for header in page.headers.values())
    return f"{title} (not the frozen protocol)" if changed else title


# Words on the trials in which the policies beside a run were scored.


def same_trials(others: Sequence[Passed], n: int) -> str:
    """Return words that continue "other policies": whether they have the trials of the run.

    Args:
        others: at least one policy beside the run.
        n: trials of the run.
    """
    without = [row for row in others if not row.n_pairs]
    if len(without) == len(others):
        return "with other seeds: they have none of these trials"
    if not without:
        return "in the same trials" + ("" if all(row.n_pairs == n for row in others) else ", as far as they have them")
    short = short_names([row.policy for row in others])
    names = ", ".join(short[row.policy] for row in without)
    return f"in the same trials, as far as they have them, or, having none of these trials, with other seeds ({names})"


# One self-contained page about one run: no network, one script that sorts and filters the table of trials, the same
# bytes for the same inputs.

FILE_NAME = "report.html"
TITLES = {
    "funnel": ("funnel", "Success"), "by task": ("tasks", "Tasks"), "safety": ("safety", "Safety"),
    "load": ("load", "Load"), "gates": ("gates", "Gates"), "baselines": ("baselines", "Baselines"),
    "failures": ("failures", "Failures"), "trials": ("trials", "Trials"), "traces": ("force", "Force"),
    "frames": ("peak", "Peak force"), "caveats": ("caveats", "Caveats"), "provenance": ("provenance", "Provenance"),
}  # fmt: skip
"""Section -> its id and its short name in the list at the top of the page."""
Read = Callable[[str], Recording]


def write_report(
    run_folder: Path,
    *,
    scores: Sequence[TrialScore],
    recordings: Read,
    skipped: Mapping[str, str],
    missing: Sequence[str] = (),
    elsewhere: Sequence[str] = (),
    baselines: Baselines | None = None,
    lost_baselines: Mapping[str, str] | None = None,
    kept_scores: str = "",
) -> Path:
    """Write ``run_folder/report.html`` and return its path.

    Planned trials without a verdict are listed in a box of their own; they make every count an interval.
    Raises ConfigError if the scores mix protocols, policies or worlds.

    Args:
        recordings: trial id -> its recording. Called once for each trial shown in detail; the result is dropped before
            the next, so a long run needs the memory of one. A recording that raises RecordingError is named on the
            page.
        skipped: trial id or file name -> why it has no score.
        missing: trials that were planned and have no score.
        elsewhere: trials of the other parts of the run.
        baselines: blind baselines that stand beside the run; None: the page says that there are none.
        lost_baselines: baseline that belongs there -> why it is not.
        kept_scores: why the kept scores of the shipped policies do not stand beside the run; empty where they do.
    """
    check_one_run(scores)
    ordered = sorted_scores(scores)
    counted = judged(ordered)
    page = Page(
        folder=run_folder, scores=ordered, judged=counted, shown=trials_in_detail(counted), skipped=skipped,
        unjudged=unjudged(ordered, skipped=skipped, missing=missing, elsewhere=elsewhere),
        baselines=baselines, lost_baselines=lost_baselines or {},
        kept_scores=kept_scores, links=_links(run_folder, ordered),
    )  # fmt: skip
    _read(page, recordings)
    path = run_folder / FILE_NAME
    replace_file(path, _render(page).encode("utf-8", errors="replace"))
    link_report(run_folder, (score.trial_id for score in ordered))
    return path


def _links(run_folder: Path, scores: Sequence[TrialScore]) -> dict[str, str]:
    """Return what lies in the folder of the run: recording, log, page and video of each trial."""
    endings = ("{}.h5", "{}.log", "trial/{}.html", "trial/{}.mp4")
    names = [ending.format(score.trial_id) for score in scores for ending in endings]
    return {name: quote(name) for name in names if (run_folder / name).is_file()}


def _read(page: Page, recordings: Read) -> None:
    sections = sections_in_order()
    page.kept.update((section.name, {}) for section in sections)
    for score in hardest_first(page.shown):
        try:
            recording = recordings(score.trial_id)
            for section in sections:
                if section.keep is not None:
                    section.keep(score, recording, page.kept[section.name])
            page.headers[score.trial_id] = recording.header
        except RecordingError as error:
            page.unread[score.trial_id] = str(error)


def _render(page: Page) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment: Any = Environment(
        loader=PackageLoader("carecontact.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    found = [(section, section.data(page)) for section in sections_in_order()]
    return environment.get_template("report.html.j2").render(
        version=__version__,
        policy=page.scores[0].policy_title if page.scores else None,
        protocol=protocol_of(page),
        script_source=script_source(),
        contents=[TITLES[row.name] for row, data in found if data is not None and row.name in TITLES],
        sections=[environment.from_string(row.template).render(data) for row, data in found if data is not None],
    )
