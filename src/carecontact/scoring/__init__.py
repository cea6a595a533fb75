"""Scores: a pure function of a recording. Needs no simulator."""

from carecontact.scoring.metric import METRICS, Metric
from carecontact.scoring.result import Anatomy, Attribution, FailureMode, TrialScore
from carecontact.scoring.run import RunScores, read_results, results, score_run, summarise, write_scores
from carecontact.scoring.score import score_recording

__all__ = [
    "METRICS",
    "Anatomy",
    "Attribution",
    "FailureMode",
    "Metric",
    "RunScores",
    "TrialScore",
    "read_results",
    "results",
    "score_recording",
    "score_run",
    "summarise",
    "write_scores",
]
