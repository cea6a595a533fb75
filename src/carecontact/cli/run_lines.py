"""The lines of JSON that `carecontact run --json` prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.cli.json_lines import say

if TYPE_CHECKING:
    from carecontact.contract.trial import TrialSpec
    from carecontact.trials.scorer import Scorer
    from carecontact.trials.supervisor import RunSummary, TrialEvent


def say_trial(event: TrialEvent, folder: Path, scorer: Scorer) -> None:
    """Write how a trial ended, if the event is its end.

    Args:
        scorer: was given the trials that ran.
    """
    from carecontact.cli.answers.run import TrialAnswer

    if event.kind not in ("kept", "finished") or event.ended is None:
        return
    kept = event.kind == "kept"
    # An earlier command may have kept many, and results.json has the scores of all of them in the end.
    score = None if kept else scorer.score_of(folder / f"{event.trial_id}.h5")
    say(
        TrialAnswer(
            trial_id=event.trial_id,
            ended=event.ended,
            kept=kept,
            done=event.done,
            total=event.total,
            message=event.message,
            score=score,
        )
    )


def say_run(spec: TrialSpec, folder: Path, summary: RunSummary, *, status: int) -> None:
    """Write the summary of the run.

    Args:
        spec: any trial of the run.
    """
    from carecontact.cli.answers.run import RunAnswer, RunProtocol
    from carecontact.cli.rescoring import RESULTS

    try:
        results = json.loads((folder / RESULTS).read_bytes())
    except FileNotFoundError:
        results = {"overall": None, "skipped": {}}
    protocol = spec.protocol
    say(
        RunAnswer(
            folder=str(folder),
            policy=spec.policy,
            protocol=RunProtocol(id=protocol.name, sha256=protocol.sha256, overrides=protocol.overrides),
            ended=summary.ended,
            ran=list(summary.ran),
            kept=list(summary.kept),
            late=summary.late,
            skipped=results["skipped"],
            overall=results["overall"],
            status=status,
        )
    )
