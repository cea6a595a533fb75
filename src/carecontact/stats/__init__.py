"""Statistics over trial scores: intervals, tests, rankings and what a comparison could have detected."""

from carecontact.stats.bootstrap import BootstrapDifference, clustered_bootstrap
from carecontact.stats.contrasts import FisherExact, MannWhitney, fisher_exact, mann_whitney
from carecontact.stats.differences import (
    RateDifference,
    difference_of_rates,
    paired_difference,
    unpaired_difference,
)
from carecontact.stats.family import Holm, holm
from carecontact.stats.mcnemar import McNemar, mcnemar_exact
from carecontact.stats.persons import PersonDifference, PersonRate, person_difference, person_rate
from carecontact.stats.power import (
    DetectableDifference,
    detectable_from_standard_error,
    paired_detectable_difference,
    unpaired_detectable_difference,
)
from carecontact.stats.proportions import Proportion, wilson_interval
from carecontact.stats.ranking import KendallTau, RankingSweep, kendall_tau, ranking_sweep
from carecontact.stats.sign_flip import SignFlip, sign_flip
from carecontact.stats.strata import stratified_weights
from carecontact.stats.summary import Median, median
from carecontact.stats.wilcoxon import SignedRank, signed_rank
from carecontact.stats.worst_rank import WorstRank, worst_rank_paired, worst_rank_unpaired
from carecontact.stats.worst_share import WorstShare, worst_share

__all__ = [
    "BootstrapDifference",
    "DetectableDifference",
    "FisherExact",
    "Holm",
    "KendallTau",
    "MannWhitney",
    "McNemar",
    "Median",
    "PersonDifference",
    "PersonRate",
    "Proportion",
    "RankingSweep",
    "RateDifference",
    "SignFlip",
    "SignedRank",
    "WorstRank",
    "WorstShare",
    "clustered_bootstrap",
    "detectable_from_standard_error",
    "difference_of_rates",
    "fisher_exact",
    "holm",
    "kendall_tau",
    "mann_whitney",
    "mcnemar_exact",
    "median",
    "paired_detectable_difference",
    "paired_difference",
    "person_difference",
    "person_rate",
    "ranking_sweep",
    "sign_flip",
    "signed_rank",
    "stratified_weights",
    "unpaired_detectable_difference",
    "unpaired_difference",
    "wilson_interval",
    "worst_rank_paired",
    "worst_rank_unpaired",
    "worst_share",
]
