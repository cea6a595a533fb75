"""Statistics over trial scores: intervals, tests, rankings and what a comparison could have detected."""

from carecontact.stats.bootstrap import BootstrapDifference, clustered_bootstrap
from carecontact.stats.contrasts import FisherExact, MannWhitney, fisher_exact, mann_whitney
from carecontact.stats.differences import RateDifference, paired_difference, unpaired_difference
from carecontact.stats.family import Holm, holm
from carecontact.stats.mcnemar import McNemar, mcnemar_exact
from carecontact.stats.power import (
    DetectableDifference,
    detectable_from_standard_error,
    paired_detectable_difference,
    unpaired_detectable_difference,
)
from carecontact.stats.proportions import Proportion, wilson_interval
from carecontact.stats.ranking import KendallTau, RankingSweep, kendall_tau, ranking_sweep
from carecontact.stats.summary import Median, median
from carecontact.stats.wilcoxon import SignedRank, signed_rank
from carecontact.stats.worst_rank import WorstRank, worst_rank_paired, worst_rank_unpaired

__all__ = [
    "BootstrapDifference",
    "DetectableDifference",
    "FisherExact",
    "Holm",
    "KendallTau",
    "MannWhitney",
    "McNemar",
    "Median",
    "Proportion",
    "RankingSweep",
    "RateDifference",
    "SignedRank",
    "WorstRank",
    "clustered_bootstrap",
    "detectable_from_standard_error",
    "fisher_exact",
    "holm",
    "kendall_tau",
    "mann_whitney",
    "mcnemar_exact",
    "median",
    "paired_detectable_difference",
    "paired_difference",
    "ranking_sweep",
    "signed_rank",
    "unpaired_detectable_difference",
    "unpaired_difference",
    "wilson_interval",
    "worst_rank_paired",
    "worst_rank_unpaired",
]
