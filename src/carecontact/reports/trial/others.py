"""What other policies did in the same trial: the same task and person under the same protocol."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from carecontact.reports.compare.blind_floor import role_in
from carecontact.reports.compare.comparable import trials_by_key
from carecontact.reports.page.trial_words import result_word
from carecontact.reports.page_links import page_path
from carecontact.reports.replay_commands import replay_commands
from carecontact.reports.short_names import short_names
from carecontact.reports.text import NA, number
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore

ROLE_NOTES = {"blind": "blind baseline", "privileged": "ceiling: it is given the simulation", "probe": "probe"}


@dataclass(frozen=True, kw_only=True)
class Beside:
    """A run of another policy."""

    scores: Mapping[tuple[str, int], TrialScore]
    """(task, seed) -> its trial"""
    role: str
    folder: Path | None = None
    """Folder of the run's recordings; None for scores that are kept with the package."""

    @classmethod
    def of(cls, run: RunScores, folder: Path | None = None) -> Beside:
        return cls(scores=trials_by_key(run.scores), role=role_in(run.scores), folder=folder)


@dataclass(frozen=True, kw_only=True)
class OtherRow:
    """What one policy did."""

    name: str
    whole: str
    """Name with arguments; empty where it is ``name``."""
    note: str
    """What the policy is for, if it is no method."""
    result: str
    """Style of the result; the words are in ``result_text``."""
    result_text: str
    peak: str
    """Peak force [N]."""
    mode: str
    """Failure mode; empty if none."""
    address: str
    """Address of the page of its trial; empty where there is none."""


def other_rows(score: TrialScore, beside: Sequence[Beside], run_folder: Path) -> list[OtherRow]:
    """Return one row for each policy that has a trial of the same task and seed, in the order given.

    Args:
        run_folder: of ``score``, from whose page the rows link others.
    """
    found = [(row, row.scores[key]) for row in beside if (key := (score.task_id, score.seed)) in row.scores]
    names = short_names([other.policy_title for _, other in found])
    return [_row(names[other.policy_title], other, row, run_folder) for row, other in found]


def how_to_compare(score: TrialScore, run_folder: Path) -> tuple[str, ...]:
    """Return the commands that set blind replay beside a trial of which no other policy's score is at hand; empty for a
    policy that is no method."""
    if role_in([score]) != "method" or score.ended == "harness_error":
        return ()
    return replay_commands([score], run_folder, trials=True)


def _row(name: str, other: TrialScore, row: Beside, run_folder: Path) -> OtherRow:
    result, text = result_word(other)
    page = None if row.folder is None else page_path(row.folder, other.trial_id)
    from_here = page_path(run_folder, other.trial_id).parent
    linked = page is not None and page.is_file()
    return OtherRow(
        name=name,
        whole="" if name == other.policy_title else other.policy_title,
        note=ROLE_NOTES.get(row.role, ""),
        result=result,
        result_text=text,
        peak=NA if other.c1_peak_force_n is None else number(other.c1_peak_force_n, 1),
        mode=(other.failure_mode or "").replace("_", " "),
        address=quote(os.path.relpath(page.resolve(), from_here.resolve())) if linked and page is not None else "",
    )
