"""A folder of trials: what was planned, what decided its numbers, and its scores; nothing here starts a trial."""

from carecontact.runs.pooling import RunScores
from carecontact.runs.results_file import read_results, results, summarise, write_scores
from carecontact.runs.scoring import Appended, append_metrics, score_run

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
