"""The scores that are kept of the shipped policies and blind baselines, for runs of the same protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from carecontact.errors import CarecontactError
from carecontact.policies.registry import POLICIES
from carecontact.protocols import load_protocol
from carecontact.reports.compare.baselines import Baselines, beside_baselines, check_baselines
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores

PACKAGE = Path(__file__).parents[2]
FOLDERS = (PACKAGE / "assets" / "results", PACKAGE.parents[1] / "docs" / "results")
"""The folders in which ``tools/keep_sweep.py`` leaves kept scores, with a folder for each protocol: in the package, or
in the clone that it is installed from."""


def beside_kept(
    run: RunScores, named: Sequence[RunScores], *, folders: Sequence[Path] = FOLDERS
) -> tuple[Baselines | None, str]:
    """Set the named baselines and the kept scores beside a run; of one trial of one policy, the named one.

    Returns:
        The policies beside the run, None without any; and why no kept scores are among them, empty where some are.

    Raises:
        ConfigError: a named baseline cannot be compared (``check_baselines``).
    """
    check_baselines(run, named)
    whole = [completed_from_kept(run, one, folders=folders) for one in named]
    kept, why = kept_for(run, whole, folders=folders)
    if not whole and not kept:
        return None, why
    completed = [one.scores[0].policy_title for one, given in zip(whole, named, strict=True) if one is not given]
    found = beside_baselines(run, whole, kept=kept)
    return replace(found, completed=tuple(completed)), "" if kept else why


def completed_from_kept(run: RunScores, named: RunScores, *, folders: Sequence[Path] = FOLDERS) -> RunScores:
    """Return a named baseline with the kept trials of the same policy that it has not; unchanged where none are kept
    that can stand beside it."""
    for file in _files(run.scores[0].protocol_id, folders) if run.scores else ():
        try:
            kept = read_scores(file).scores
            if kept[0].policy_title != named.scores[0].policy_title:
                continue
            taken = {s.trial_id for s in named.scores}
            further = [s for s in kept if s.trial_id not in taken]
            if not further:
                return named
            both = replace(named, scores=[*named.scores, *further])
            check_baselines(run, [both])
        except CarecontactError:
            continue
        return both
    return named


def kept_for(
    run: RunScores, named: Sequence[RunScores], *, folders: Sequence[Path] = FOLDERS
) -> tuple[list[RunScores], str]:
    """Return the kept scores that can stand beside a run and the named baselines, and why there are none; the reason is
    empty for a run without trials."""
    if not run.scores:
        return [], ""
    taken = {run.scores[0].policy_title, *(other.scores[0].policy_title for other in named)}
    kept: list[RunScores] = []
    why = ""
    for file in _files(run.scores[0].protocol_id, folders):
        try:
            scores = read_scores(file)
            title = scores.scores[0].policy_title
            if title not in taken:
                check_baselines(run, [*named, *kept, scores])
                kept.append(scores)
        except CarecontactError as error:
            why = why or f"The kept scores of {file.name.partition('.')[0]} cannot stand beside this run: {error}."
    return kept, "" if kept else why or _none_kept(run.scores[0].protocol_id)


def _files(protocol_id: str, folders: Sequence[Path]) -> list[Path]:
    """Return one file for each registered policy under the protocol's own settings: other settings have a longer name.
    The folder of a level is PROTOCOL-LEVEL."""
    for folder in folders:
        found = [
            path
            for name in sorted(POLICIES)
            if (path := folder / protocol_id.replace(" ", "-") / f"{name}.json.gz").is_file()
        ]
        if found:
            return found
    return []


def _none_kept(protocol_id: str) -> str:
    name, _, level = protocol_id.partition(" ")
    try:
        draft = not load_protocol(name, level=level or None).frozen
    except CarecontactError:
        draft = False
    because = ", because it is a draft" if draft else ""
    return f"No scores of the shipped policies and of blind replay are kept for {protocol_id}{because}."
