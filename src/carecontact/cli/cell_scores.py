"""The scores of a cell of a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import ConfigError, DependencyError

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores
    from carecontact.trials.scorer import Scorer


def stored(folder: Path) -> RunScores | None:
    """Return the scores in a cell's results.json, or None if there is none that belongs to the cell's recordings."""
    from carecontact.runs.stored_scores import read_scores

    try:
        return read_scores(folder)
    except (ConfigError, DependencyError):
        return None


def computed(folder: Path) -> RunScores | None:
    """Return the scores that ``stored`` finds, or else those of the recordings in the folder. Nothing is written."""
    from carecontact.runs import score_run
    from carecontact.runs.stored_scores import beside_plan

    if (found := stored(folder)) is not None or not any(folder.glob("*.h5")):
        return found
    return beside_plan(folder, score_run(folder))


def store(folder: Path, *, anew: bool, scorer: Scorer | None = None) -> None:
    """Write the results of a cell. Unless ``anew`` is true, existing results that belong to its recordings stay.

    Args:
        scorer: has scored the trials that ran; it scores the others too.
    """
    from carecontact.runs import score_run, write_scores
    from carecontact.runs.stored_scores import beside_plan

    if anew or stored(folder) is None:
        if scorer is None:
            scores = score_run(folder)
        else:
            scorer.fill(sorted(folder.glob("*.h5")))
            scores = score_run(folder, scored=scorer.take)
        write_scores(folder, beside_plan(folder, scores))
