"""From a recording to the scores of its trial: contact, actions, verdict, metrics, attribution; without a simulator."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carecontact.scoring.metrics.metric import METRICS, Metric, metric
    from carecontact.scoring.result import Anatomy, Attribution, FailureMode, TrialScore
    from carecontact.scoring.score import score_recording

# Imported when they are used: actions need modules of this package, and with them every process of a trial.
_OFFERED = {
    "metrics.metric": ("METRICS", "Metric", "metric"),
    "result": ("Anatomy", "Attribution", "FailureMode", "TrialScore"),
    "score": ("score_recording",),
}

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


def __getattr__(name: str) -> object:
    for module, names in _OFFERED.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
