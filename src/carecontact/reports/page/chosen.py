"""Which trials of a long run a page shows one by one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from carecontact.scoring.result import TrialScore

FULL_DETAIL = 21
"""Up to this many trials every one is shown in detail."""
FAILURES_SHOWN = 14
"""Beyond FULL_DETAIL: one trial a task, and this many of those that did not pass."""


def trials_in_detail(ordered: Sequence[TrialScore]) -> list[TrialScore]:
    """Return all trials of a short run; of a longer one, each task's first and FAILURES_SHOWN that did not pass.

    The failures are taken in turn from all tasks, so that one bad task does not crowd out the others.
    """
    if len(ordered) <= FULL_DETAIL:
        return list(ordered)
    first = {s.task_id: s.trial_id for s in reversed(ordered)}
    chosen = set(first.values())
    rank: Counter[str] = Counter()
    queue: list[tuple[int, str, str]] = []
    for score in ordered:
        if not score.safety_gated and score.trial_id not in chosen:
            queue.append((rank[score.task_id], score.task_id, score.trial_id))
            rank[score.task_id] += 1
    chosen |= {trial_id for _, _, trial_id in sorted(queue)[:FAILURES_SHOWN]}
    return [s for s in ordered if s.trial_id in chosen]


def hardest_first(chosen: Sequence[TrialScore]) -> list[TrialScore]:
    """Hardest contact of each task first: its frame is the one shown."""
    return sorted(chosen, key=lambda s: (s.task_id, -(s.c1_peak_force_n or 0.0), s.seed))
