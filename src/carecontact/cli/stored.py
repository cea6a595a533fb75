"""Read the scores of a run for a command that shows them."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carecontact.runs.run_scores import RunScores


def read_run(run: Path, *, rescore: bool | None = None) -> RunScores:
    """Read the scores as ``read_scores`` does. For a folder of recordings, also print which registered metrics they
    lack.

    Args:
        run: folder of a run, or its results file.
        rescore: whether the option --rescore is given; None for a command that has no such option.
    """
    from carecontact.runs.stored_scores import lacking, read_scores

    scores = read_scores(run, rescore=bool(rescore), otherwise="" if rescore is None else ", or add --rescore")
    if any(run.glob("*.h5")) and (absent := lacking(scores)):
        command = f"carecontact score {shlex.quote(str(run))} --append"
        print(f"{run} was scored without {', '.join(absent)}; `{command}` adds what is missing")
    return scores
