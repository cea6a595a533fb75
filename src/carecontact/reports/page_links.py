"""The links between a run's report and the pages of its trials, whichever of them is written first.

A page that is written before the report holds the link to it hidden, and a report that is written before a page names
the trial without an address. Whoever is written second completes the first.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from urllib.parse import quote

from carecontact.recording.writer import replace_file

REPORT = "report.html"
"""In the folder of a run."""
FOLDER = "trial"
HIDDEN, SHOWN = '<span hidden> · <a href="{}">', '<span> · <a href="{}">'
WAITING, LINKED = '<a data-page="{}">', '<a href="{}">'
"""Of the report: a trial whose page is not there, and one whose page is."""


def page_path(run_folder: Path, trial_id: str) -> Path:
    """The place of a trial's page, whether the page exists or not."""
    return run_folder / FOLDER / f"{trial_id}.html"


def page_address(trial_id: str) -> str:
    """Of a trial's page, from the report."""
    return quote(f"{FOLDER}/{trial_id}.html")


def report_address(trial_id: str) -> str:
    """Of the row of a trial in the report, from the page of the trial."""
    return f"../{REPORT}#{quote(trial_id)}"


def report_link(run_folder: Path, trial_id: str) -> str:
    """The beginning of the link to the report on the page of a trial: hidden while there is no report."""
    return (SHOWN if (run_folder / REPORT).is_file() else HIDDEN).format(report_address(trial_id))


def link_to_page(trial_id: str, *, is_there: bool) -> str:
    """The beginning of the link to the page of a trial in the report; without an address while there is no page."""
    return (LINKED if is_there else WAITING).format(page_address(trial_id))


def link_page(run_folder: Path, trial_id: str) -> None:
    """Link the page of a trial in the report, if there is one."""
    address = page_address(trial_id)
    _replace(run_folder / REPORT, WAITING.format(address), LINKED.format(address))


def link_report(run_folder: Path, trial_ids: Iterable[str]) -> None:
    """Show the link to the report on those of the trials' pages that are there."""
    for trial_id in trial_ids:
        address = report_address(trial_id)
        _replace(page_path(run_folder, trial_id), HIDDEN.format(address), SHOWN.format(address))


def _replace(path: Path, old: str, new: str) -> None:
    if path.is_file() and old in (text := path.read_text(encoding="utf-8", errors="replace")):
        replace_file(path, text.replace(old, new).encode("utf-8", errors="replace"))
