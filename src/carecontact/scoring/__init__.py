"""Scores: a pure function of a recording. Needs no simulator."""

from carecontact.scoring.append import Appended, append_metrics
from carecontact.scoring.metric import METRICS, Metric
from carecontact.scoring.result import Anatomy, Attribution, FailureMode, TrialScore
from carecontact.scoring.run import RunScores, read_results, results, score_run, summarise, write_scores
from carecontact.scoring.score import score_recording

__all__ = [
    "METRICS",
    "Anatomy",
    "Appended",
    "Attribution",
    "FailureMode",
    "Metric",
    "RunScores",
    "TrialScore",
    "append_metrics",
    "read_results",
    "results",
    "score_recording",
    "score_run",
    "summarise",
    "write_scores",
]
