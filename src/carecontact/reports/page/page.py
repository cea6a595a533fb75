"""One self-contained page about one run: no network, one script that sorts and filters the table of trials, the same
bytes for the same inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from carecontact import __version__
from carecontact.errors import RecordingError
from carecontact.recording.schema import Recording
from carecontact.recording.writer import replace_file
from carecontact.reports.compare.baselines import Baselines
from carecontact.reports.page.chosen import hardest_first, trials_in_detail
from carecontact.reports.page.script import script_source
from carecontact.reports.page.section import Page, sections_in_order
from carecontact.reports.page.title import protocol_of
from carecontact.reports.page_links import link_report
from carecontact.reports.table import sorted_scores
from carecontact.runs.pooling import check_one_run, judged, unjudged
from carecontact.scoring.result import TrialScore

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
        loader=PackageLoader("carecontact.reports.page"), autoescape=True, undefined=StrictUndefined,
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
