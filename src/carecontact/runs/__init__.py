"""A folder of trials: what was planned, what decided its numbers, and its scores."""

from carecontact.runs.append import Appended, append_metrics
from carecontact.runs.results_content import results, summarise
from carecontact.runs.results_file import read_results, write_scores
from carecontact.runs.run_scores import RunScores
from carecontact.runs.score_folder import score_run

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
