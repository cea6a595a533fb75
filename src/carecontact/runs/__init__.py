"""A folder of trials: what was planned, what decided its numbers, and its scores."""

from carecontact.runs.append import Appended, append_metrics
from carecontact.runs.scores import RunScores, read_results, results, score_run, summarise, write_scores

__all__ = [
    "Appended",
    "RunScores",
    "append_metrics",
    "read_results",
    "results",
    "score_run",
    "summarise",
    "write_scores",
]
