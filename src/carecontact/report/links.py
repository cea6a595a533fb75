"""Links between a run's report and the pages of its trials, and the commands that replay them."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

from carecontact.protocol.load import shipped_protocols
from carecontact.protocol.overrides import shipped_tissue_sets
from carecontact.recording.file import replace_file
from carecontact.runs.plan import compact
from carecontact.scoring.result import TrialScore

# The links between a run's report and the pages of its trials, whichever of them is written first.
#
# A page that is written before the report holds the link to it hidden, and a report that is written before a page names
# the trial without an address. The one that is written second completes the first.

REPORT = "report.html"
"""Name of the report in the folder of a run."""
FOLDER = "trial"
HIDDEN, SHOWN = '<span hidden> · <a href="{}">', '<span> · <a href="{}">'
WAITING, LINKED = '<a data-page="{}">', '<a href="{}">'
"""Parts of the report that name a trial: one whose page is not there, and one whose page is."""


def page_path(run_folder: Path, trial_id: str) -> Path:
    """Return the place of a trial's page, whether the page exists or not."""
    return run_folder / FOLDER / f"{trial_id}.html"


def link_to_page(trial_id: str, *, is_there: bool) -> str:
    """Return the beginning of the link from the report to the page of a trial; without an address while there is no
    page."""
    return (LINKED if is_there else WAITING).format(quote(f"{FOLDER}/{trial_id}.html"))


def link_report(run_folder: Path, trial_ids: Iterable[str]) -> None:
    """Show the link to the report on those of the trials' pages that are there."""
    for trial_id in trial_ids:
        _show(page_path(run_folder, trial_id), _report_address(trial_id))


def links_of_page(run_folder: Path, trial_id: str) -> list[tuple[str, str]]:
    """Return words and beginnings of the links from the page of a trial to the report, and to the pages of the trials
    before and after it in the order of the recordings; a link is hidden while its page is not there."""
    targets = [("report of the run", run_folder / REPORT, _report_address(trial_id))]
    for words, name in _neighbours(run_folder, trial_id):
        targets.append((words, page_path(run_folder, name), quote(f"{name}.html")))
    return [(words, (SHOWN if path.is_file() else HIDDEN).format(address)) for words, path, address in targets]


def link_page(run_folder: Path, trial_id: str) -> None:
    """Link the page of a trial in the report and on the pages of the trials before and after it."""
    waiting, linked = (link_to_page(trial_id, is_there=is_there) for is_there in (False, True))
    _replace(run_folder / REPORT, waiting, linked)
    for _, name in _neighbours(run_folder, trial_id):
        _show(page_path(run_folder, name), quote(f"{trial_id}.html"))


def _report_address(trial_id: str) -> str:
    return f"../{REPORT}#{quote(trial_id)}"


def _show(page: Path, address: str) -> None:
    _replace(page, HIDDEN.format(address), SHOWN.format(address))


def _neighbours(run_folder: Path, trial_id: str) -> list[tuple[str, str]]:
    names = sorted({path.stem for path in run_folder.glob("*.h5")} | {trial_id})
    at = names.index(trial_id)
    found = [("previous trial", names[at - 1])] if at else []
    return found + [("next trial", name) for name in names[at + 1 : at + 2]]


def _replace(path: Path, old: str, new: str) -> None:
    if path.is_file() and old in (text := path.read_text(encoding="utf-8", errors="replace")):
        replace_file(path, text.replace(old, new).encode("utf-8", errors="replace"))


MAX_TEXT = 400
"""Characters of a message that a policy wrote."""


def inside(folder: Path, message: str) -> str:
    """Return the message without the path to the run, so that a run that was moved gives the same page."""
    return message.replace(f"{folder}{os.sep}", "")


def of_file(name: str, message: str) -> str:
    """Return the message without the folder in which the file lay when it was written; results.json keeps such
    messages."""
    return re.sub(rf"^\S*{re.escape(os.sep)}{re.escape(name)}(?=:)", name, message)


def shortened(text: str) -> str:
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]} …"


OPTIONS = {
    "person.body": "--body", "person.tissue_set": "--tissue", "scene.tool": "--tool",
    "impedance.translational_n_m": "--stiffness",
}  # fmt: skip
"""Replaced field of the protocol -> the option of ``carecontact run`` that replaces it; ``--set`` replaces others."""


def replay_commands(scores: Sequence[TrialScore], folder: Path, *, trials: bool = False) -> tuple[str, str]:
    """Return the command that runs blind replay under the rules of a run, and the one that writes its report with it.

    Args:
        scores: of the run's trials, at least one; replay runs the tasks and seeds among them.
        folder: of the run, as the command that writes the page names it.
        trials: whether the report writes the pages of the trials as well.
    """
    out = _beside(folder)
    tasks = sorted({score.task_id for score in scores})
    seeds = compact({score.seed for score in scores}).replace(" ", "")
    run = ["carecontact", "run", "--policy", "replay", *rules_options(scores[0])]
    report = ["carecontact", "report", str(folder), *["--trials"] * trials, "--baseline", out]
    return shlex.join([*run, "--tasks", ",".join(tasks), "--seeds", seeds, "--out", out]), shlex.join(report)


def rules_options(score: TrialScore) -> list[str]:
    """Return options of ``carecontact run`` that give the rules of a trial: protocol, level and every replaced field.

    A file that a score does not name stands as ``FILE.toml`` (protocol, tissue), ``FOLDER`` (weights) or ``FILE``
    (salt).
    """
    name, _, level = score.protocol_id.partition(" ")
    found = ["--protocol", name if name in shipped_protocols() else "FILE.toml"]
    found += ["--level", level] if level else []
    for field, value in sorted(score.overrides.items()):
        if field == "lock":
            found.append("--unfrozen")
        elif field == "vision.segmenter":
            model, _, weights = value.partition(" ")
            found += ["--segmenter", model, *(["--weights", "FOLDER"] if weights else [])]
        elif field in OPTIONS:
            # The set of a calibration is a file that the score does not name.
            is_file = OPTIONS[field] == "--tissue" and value not in shipped_tissue_sets()
            found += [OPTIONS[field], "FILE.toml" if is_file else value]
        else:
            found += ["--set", f"{field}={value}"]
    found += ["--allow-rejected"] if score.world.get("rejected_tissue") else []
    return found + (["--salt-file", "FILE"] if score.world.get("salt") else [])


def _beside(folder: Path) -> str:
    """Return a folder for the other run, beside that of this one."""
    if folder.name in ("", ".."):
        return str(folder / ".." / f"{folder.resolve().name}-replay")
    return str(folder.with_name(f"{folder.name}-replay"))
