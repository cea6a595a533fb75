"""The page of a run: what a section of it is and may use, and how the page is made of all sections."""

from __future__ import annotations

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from carecontact import __version__
from carecontact.errors import RecordingError, counted
from carecontact.protocol.protocol import Protocol
from carecontact.recording.file import replace_file
from carecontact.recording.schema import Header, Recording
from carecontact.registry import Registry
from carecontact.report.baselines import Baselines
from carecontact.report.links import REPORT, link_report, shortened
from carecontact.report.tables import sorted_scores
from carecontact.report.words import enough, listed, minus, percent, rounded, task_name
from carecontact.runs.pooling import check_one_run, judged, rate_of, unjudged
from carecontact.scoring.result import TrialScore
from carecontact.stats import Proportion, wilson_interval

FULL_DETAIL = 21
"""Up to this many trials, the page shows every trial in detail."""
FAILURES_SHOWN = 14
"""Of a longer run, the page shows one trial of each task and this many further ones that did not pass."""
FOLD = 100
"""Sections of this order and above are inside the fold."""

Kept = dict[Any, Any]
Read = Callable[[str], Recording]


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
    """The policies that stand beside the run."""
    lost_baselines: Mapping[str, str]
    """Baseline that stood beside the run -> why it cannot any more."""
    kept_scores: str = ""
    """Why the kept scores of the shipped policies do not stand beside the run; empty where they do."""
    links: Mapping[str, str] = field(default_factory=dict[str, str])
    """Existing file in the run's folder that the page may link -> its address."""
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
    def planned(self) -> int:
        return len(self.judged) + len(self.unjudged)

    @property
    def trials(self) -> str:
        """``7 trials``, or ``15 trials with a verdict, of 18 planned``."""
        trials = counted(len(self.judged), "trial")
        return f"{trials} with a verdict, of {self.planned} planned" if self.unjudged else trials

    @property
    def passed(self) -> Proportion:
        """Share of the planned trials that are safety-gated; those without a verdict widen its interval."""
        found, unknown = rate_of(self.judged, "safety_gated"), len(self.unjudged)
        if not unknown:
            return found
        low, high = wilson_interval(found.k, self.planned).low, wilson_interval(found.k + unknown, self.planned).high
        return replace(found, n=self.planned, estimate=None, low=low, high=high)

    @property
    def gamma(self) -> float | None:
        """The protocol's discount of the pain limits."""
        return None if self.protocol is None else self.protocol.limits.gamma


Data = Callable[[Page], Mapping[str, Any] | None]
Keep = Callable[[TrialScore, Recording, Kept], None]


@dataclass(frozen=True, kw_only=True)
class Section:
    name: str
    """With hyphens for spaces, also the id of the section."""
    title: str
    """Empty: the template has its own frame, as the headline has."""
    order: int
    """Place on the page, lowest first."""
    data: Data
    """What the template in the file of the section's id sees; None: the page goes without this section."""
    keep: Keep | None = None
    """Sees each recording of ``Page.shown`` once, hardest contact of a task first, and puts what the section needs of
    it into the section's own dictionary. A RecordingError makes the trial one of ``Page.unread``."""
    style: str = ""

    @property
    def id(self) -> str:
        return self.name.replace(" ", "-")


SECTIONS: Registry[Section] = Registry("section", scan="carecontact.report.sections")


def section(
    name: str, title: str = "", *, order: int, keep: Keep | None = None, style: str = ""
) -> Callable[[Data], Data]:
    """Register a function of the page as a section."""

    def register(data: Data) -> Data:
        SECTIONS.register(name, Section(name=name, title=title, order=order, data=data, keep=keep, style=style))
        return data

    return register


@cache
def environment() -> Any:
    """Return the environment of all templates, with the words and numbers that they write."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found: Any = Environment(
        loader=PackageLoader("carecontact.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.globals |= {"counted": counted, "enough_seeds": enough, "listed": listed, "version": __version__}
    found.filters |= {"minus": minus, "percent": percent, "rounded": rounded, "shortened": shortened}
    found.filters |= {"task_name": task_name}
    return found


def render(template: str, **data: Any) -> str:
    return environment().get_template(template).render(data)


# The page: no network, one script that sorts and filters the table of trials, the same bytes for the same inputs.


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
    """Write ``run_folder/report.html`` and return its path. Raises ConfigError as ``check_one_run``.

    Args:
        recordings: trial id -> its recording. Called once for each trial shown in detail, so a long run needs the
            memory of one. A recording that raises RecordingError is named on the page.
        skipped: trial id or file name -> why it has no score.
        missing: trials that were planned and have no score.
        elsewhere: trials of the other parts of the run.
        baselines: the policies beside the run; None: the page says that there are none.
        lost_baselines: baseline that belongs there -> why it is not.
        kept_scores: why the kept scores of the shipped policies do not stand beside the run; empty where they do.
    """
    check_one_run(scores)
    ordered = sorted_scores(scores)
    with_verdict = judged(ordered)
    page = Page(
        folder=run_folder,
        scores=ordered,
        judged=with_verdict,
        shown=trials_in_detail(with_verdict),
        skipped=skipped,
        unjudged=unjudged(ordered, skipped=skipped, missing=missing, elsewhere=elsewhere),
        baselines=baselines,
        lost_baselines=lost_baselines or {},
        kept_scores=kept_scores,
        links=_links(run_folder, ordered),
    )
    sections = sorted(SECTIONS.values(), key=lambda row: (row.order, row.name))
    _read(page, sections, recordings)
    path = run_folder / REPORT
    replace_file(path, _render(page, sections).encode("utf-8", errors="replace"))
    link_report(run_folder, (score.trial_id for score in ordered))
    return path


def trials_in_detail(ordered: Sequence[TrialScore]) -> list[TrialScore]:
    """Return all trials of a short run; of a longer one, each task's first and FAILURES_SHOWN that did not pass.

    The failures are taken in turn from all tasks, so that one bad task does not crowd out the others.
    """
    if len(ordered) <= FULL_DETAIL:
        return list(ordered)
    chosen = set({s.task_id: s.trial_id for s in reversed(ordered)}.values())
    rank: Counter[str] = Counter()
    queue: list[tuple[int, str, str]] = []
    for score in ordered:
        if not score.safety_gated and score.trial_id not in chosen:
            queue.append((rank[score.task_id], score.task_id, score.trial_id))
            rank[score.task_id] += 1
    chosen |= {trial_id for _, _, trial_id in sorted(queue)[:FAILURES_SHOWN]}
    return [s for s in ordered if s.trial_id in chosen]


def _links(run_folder: Path, scores: Sequence[TrialScore]) -> dict[str, str]:
    """Return what lies in the folder of the run: recording, log, page and video of each trial."""
    endings = ("{}.h5", "{}.log", "trial/{}.html", "trial/{}.mp4")
    names = [ending.format(score.trial_id) for score in scores for ending in endings]
    return {name: quote(name) for name in names if (run_folder / name).is_file()}


def _read(page: Page, sections: Sequence[Section], recordings: Read) -> None:
    page.kept.update((section.name, {}) for section in sections)
    for score in sorted(page.shown, key=lambda s: (s.task_id, -(s.c1_peak_force_n or 0.0), s.seed)):
        try:
            recording = recordings(score.trial_id)
            for section in sections:
                if section.keep is not None:
                    section.keep(score, recording, page.kept[section.name])
            page.headers[score.trial_id] = recording.header
        except RecordingError as error:
            page.unread[score.trial_id] = str(error)


def _render(page: Page, sections: Sequence[Section]) -> str:
    found = [(section, data) for section in sections if (data := section.data(page)) is not None]
    parts = [(section, render(f"{section.id}.html.j2", **data)) for section, data in found]
    digest = hashlib.sha256(table_script().encode()).digest()
    return render(
        "report.html.j2",
        name=page.scores[0].policy_title if page.scores else "no scored trial",
        protocol=page.scores[0].protocol_title if page.scores else "",
        # The Content-Security-Policy of the page allows this script and no other.
        script=f"'sha256-{base64.b64encode(digest).decode()}'",
        above=[part for part in parts if part[0].order < FOLD],
        fold=[part for part in parts if part[0].order >= FOLD],
    )


@cache
def table_script() -> str:
    return (files("carecontact.report") / "templates" / "trials.js").read_text(encoding="utf-8")
