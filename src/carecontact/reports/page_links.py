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
"""Name of the report in the folder of a run."""
FOLDER = "trial"
HIDDEN, SHOWN = '<span hidden> · <a href="{}">', '<span> · <a href="{}">'
WAITING, LINKED = '<a data-page="{}">', '<a href="{}">'
"""Parts of the report that name a trial: one whose page is not there, and one whose page is."""


def page_path(run_folder: Path, trial_id: str) -> Path:
    """Return the place of a trial's page, whether the page exists or not."""
    return run_folder / FOLDER / f"{trial_id}.html"


def page_address(trial_id: str) -> str:
    """Return the address of a trial's page, relative to the report."""
    return quote(f"{FOLDER}/{trial_id}.html")


def report_address(trial_id: str) -> str:
    """Return the address of a trial's row in the report, relative to the page of the trial."""
    return f"../{REPORT}#{quote(trial_id)}"


def report_link(run_folder: Path, trial_id: str) -> str:
    """Return the beginning of the link to the report on the page of a trial: hidden while there is no report."""
    return (SHOWN if (run_folder / REPORT).is_file() else HIDDEN).format(report_address(trial_id))


def link_to_page(trial_id: str, *, is_there: bool) -> str:
    """Return the beginning of the link to the page of a trial in the report; without an address while there is no
    page."""
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


def neighbour_links(run_folder: Path, trial_id: str) -> list[tuple[str, str]]:
    """Return words and beginning of the links from the page of a trial to those of the trials before and after it, in
    the order of the recordings' names; a link is hidden while that page is not there."""
    return [
        (words, (SHOWN if page_path(run_folder, name).is_file() else HIDDEN).format(quote(f"{name}.html")))
        for words, name in _neighbours(run_folder, trial_id)
    ]


def link_neighbours(run_folder: Path, trial_id: str) -> None:
    """Show the links to the page of a trial on the pages of the trials before and after it."""
    address = quote(f"{trial_id}.html")
    for _, name in _neighbours(run_folder, trial_id):
        _replace(page_path(run_folder, name), HIDDEN.format(address), SHOWN.format(address))


def _neighbours(run_folder: Path, trial_id: str) -> list[tuple[str, str]]:
    names = sorted({path.stem for path in run_folder.glob("*.h5")} | {trial_id})
    at = names.index(trial_id)
    found = [("previous trial", names[at - 1])] if at else []
    return found + [("next trial", name) for name in names[at + 1 : at + 2]]


def _replace(path: Path, old: str, new: str) -> None:
    if path.is_file() and old in (text := path.read_text(encoding="utf-8", errors="replace")):
        replace_file(path, text.replace(old, new).encode("utf-8", errors="replace"))
