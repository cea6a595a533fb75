"""Read the scores of a run for a command that shows them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores


def read_run(run: Path, *, rescore: bool = False) -> RunScores:
    """As ``read_scores``; for a folder of recordings, print which registered metrics it was scored without."""
    from carecontact.runs.stored_scores import lacking, read_scores

    scores = read_scores(run, rescore=rescore)
    if any(run.glob("*.h5")) and (absent := lacking(scores)):
        print(f"{run} was scored without {', '.join(absent)}; `carecontact score {run} --append` adds what is missing")
    return scores
