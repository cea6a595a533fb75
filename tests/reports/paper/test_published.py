"""The paper's printed values agree with one another; a slip in typing them would not."""

from __future__ import annotations

import pytest

from carecontact.reports.paper.published import read_paper
from carecontact.stats import wilson_interval

PAPER = read_paper()
GATED = {"state-machine": 79, "voxposer": 39, "pi05": 0}
"""Counts from the paper's text; successes are the sums over the regions."""
CORRECT = {"state-machine": 102, "voxposer": 39, "pi05": 0}


@pytest.mark.parametrize("name", PAPER.methods)
def test_rates_and_intervals_are_those_of_the_counts(name: str) -> None:
    method, n = PAPER.methods[name], PAPER.runs_per_method
    counts = {
        "success": sum(c["success"] for c in method.anatomy.values()),
        "region_correct": CORRECT[name],
        "safety_gated": GATED[name],
    }
    for rate, k in counts.items():
        found = wilson_interval(k, n)
        assert method.rates[rate] == pytest.approx((k / n, found.low, found.high), abs=5.1e-4), rate


@pytest.mark.parametrize("name", PAPER.methods)
def test_failures_and_regions_add_up(name: str) -> None:
    method = PAPER.methods[name]
    assert sum(c["n"] for c in method.anatomy.values()) == PAPER.runs_per_method
    assert method.failed == PAPER.runs_per_method - CORRECT[name]
    left = [c["n"] - c["target"] - c["off_target"] - c["none"] for c in method.anatomy.values()]
    assert left == {"state-machine": [3, 3, 1], "voxposer": [1, 3, 1], "pi05": [1, 2, 1]}[name], "process failures"
    if method.dominant is not None:
        assert method.dominant[1] <= method.failed


def test_the_contrasts_are_the_four_of_the_table() -> None:
    tests = {name: test for name, (test, _) in PAPER.pvalues.items()}
    rank = "Mann-Whitney U"
    assert tests == {"region_correct": "Fisher exact", "safety_gated": "Fisher exact", "C1": rank, "C5": rank}


def test_fisher_of_the_counts_is_the_printed_p() -> None:
    from carecontact.stats import fisher_exact

    for outcome, counts in (("region_correct", CORRECT), ("safety_gated", GATED)):
        found = fisher_exact(counts["state-machine"], 140, counts["voxposer"], 140).pvalue
        assert found == pytest.approx(PAPER.pvalues[outcome][1], rel=0.01)
