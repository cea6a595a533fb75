"""A run as a row of the paper's tables, with the method of the paper that it repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carecontact.reports.paper.published import Paper, PaperMethod
from carecontact.runs.pooling import judged
from carecontact.runs.run_scores import RunScores
from carecontact.scoring.result import TrialScore


@dataclass(frozen=True, kw_only=True)
class Method:
    policy: str
    title: str
    """The paper's name of the method, or else the policy with its arguments."""
    scores: list[TrialScore]
    """Scores of the trials that say something about the policy."""
    published: PaperMethod | None
    """The paper's values; None for a method that is not in the paper."""


def methods_of(runs: Sequence[RunScores], paper: Paper) -> list[Method]:
    """Return one method for each run, in their order; two of one title get a number."""
    found: list[Method] = []
    for run in runs:
        first = run.scores[0]
        published = paper.methods.get(first.policy)
        title = published.title if published and not first.policy_arguments else first.policy_title
        same = sum(method.title.partition(" (")[0] == title for method in found)
        found.append(
            Method(
                policy=first.policy,
                title=f"{title} ({same + 1})" if same else title,
                scores=judged(run.scores),
                published=published,
            )
        )
    return found
