"""How many trials pass what nursing studies ask of a wipe: the yes-or-no metrics, for the soft mitt alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carecontact.contract.protocol import Protocol
from carecontact.runs.pooling import judged
from carecontact.scoring.metrics.metric import METRICS, newest
from carecontact.scoring.result import TrialScore

ASKED = ("effective", "comfortable", "comfortable_fragile")
"""Names of the yes-or-no metrics; of each, the newest version counts by which the trials were scored."""
TOOL = "mitt"
"""A rigid cap presses a few square centimetres, so that these metrics say nothing of it."""


@dataclass(frozen=True, kw_only=True)
class NursingRow:
    metric: str
    title: str
    yes: int
    n: int
    """Trials with a value."""


def nursing_rows(scores: Sequence[TrialScore], protocol: Protocol | None) -> list[NursingRow]:
    """Return one row per metric of ASKED over the trials that are ``judged``; none where the tool is not the mitt.

    Args:
        protocol: of the run, as a recording of it holds it; None where none could be read: then the tool is unknown.
    """
    if protocol is None or protocol.scene.tool != TOOL:
        return []
    counted = judged(scores)
    rows: list[NursingRow] = []
    scored = newest({id_ for score in counted for id_ in score.additional if id_ in METRICS})
    for name in (id_ for asked in ASKED for id_ in scored if id_.partition("@")[0] == asked):
        values = [value for value in METRICS[name].pooled(counted) if value is not None]
        if values:
            rows.append(NursingRow(metric=name, title=METRICS[name].title, yes=sum(map(int, values)), n=len(values)))
    return rows
