"""Statistics over trial scores."""

from carecontact.stats.contrasts import FisherExact, MannWhitney, fisher_exact, mann_whitney
from carecontact.stats.proportions import Proportion, wilson_interval
from carecontact.stats.summary import Median, median

__all__ = [
    "FisherExact",
    "MannWhitney",
    "Median",
    "Proportion",
    "fisher_exact",
    "mann_whitney",
    "median",
    "wilson_interval",
]
