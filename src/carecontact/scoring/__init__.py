"""Scores: a pure function of a recording, without a simulator."""

from carecontact.scoring.metrics.metric import METRICS, Metric, metric
from carecontact.scoring.result import Anatomy, Attribution, FailureMode, TrialScore
from carecontact.scoring.score import score_recording

__all__ = [
    "METRICS",
    "Anatomy",
    "Attribution",
    "FailureMode",
    "Metric",
    "TrialScore",
    "metric",
    "score_recording",
]
