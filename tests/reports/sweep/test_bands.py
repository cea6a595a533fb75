"""The spread over draws, from trials whose scores are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from carecontact.reports.sweep.band_texts import flip_heads, flip_rows, spread_heads, spread_rows
from carecontact.reports.sweep.bands import Bands, bands
from carecontact.reports.sweep.table import CellScores, sweep_table
from carecontact.reports.sweep.texts import as_markdown
from tests.reports.sweep.test_levels import levels
from tests.reports.synthetic_run import FAILED, make_score


def cell(name: str, body: str, peaks: Sequence[float], *, fails: Sequence[int] = ()) -> CellScores:
    """Task T1 with a peak force [N] for each seed from 0."""
    scores = [
        make_score("T1", seed, policy=name, c1_peak_force_n=peak, **(FAILED if seed in fails else {}))
        for seed, peak in enumerate(peaks)
    ]
    return CellScores(
        label=name, values={"body": body}, folder=f"{name}_{body}", planned=len(scores), scores=scores
    )  # fmt: skip


def drawn(cells: Sequence[CellScores]) -> Bands:
    found = bands(cells, "safety_gated", ranked=list(dict.fromkeys(one.label for one in cells)))
    assert found is not None
    return found


def column(heads: Sequence[str], rows: Sequence[Sequence[str]], name: str) -> Mapping[str, str]:
    return {row[0]: row[list(heads).index(name)] for row in rows}


def test_a_band_is_over_all_draws_of_a_policy() -> None:
    found = drawn([cell("a", "thin", range(1, 12)), cell("a", "heavy", range(12, 22), fails=[0])])
    (one,) = found.spreads
    assert (one.passed, one.n) == (20, 21)
    band = one.bands["C1@1"]
    assert band is not None
    assert (band.n, band.low, band.median, band.high) == (21, 2.0, 11.0, 20.0)
    assert column(spread_heads(), spread_rows(found, {"a": "a"}), "C1 [N]")["a"].startswith("11.00 [2.00 to 20.00]")


def test_flips_are_the_draws_that_go_against_the_order_over_all() -> None:
    """b presses harder than a in three of four draws and less in one; it fails in one in which a passes."""
    cells = [
        cell("a", "thin", [2, 2]), cell("a", "heavy", [2, 2], fails=[1]),
        cell("b", "thin", [3, 1]), cell("b", "heavy", [3, 3], fails=[0, 1]),
    ]  # fmt: skip
    (pair,) = drawn(cells).flips
    assert (pair.a, pair.b, pair.by["C1@1"], pair.by["passed"]) == ("a", "b", (1, 4), (0, 4))
    assert column(flip_heads(), flip_rows(drawn(cells)), "C1")["a - b"].replace("\xa0", " ") == "1/4 (25 %)"


def test_equal_policies_have_no_order_to_flip() -> None:
    assert drawn([cell("a", "thin", [2, 3]), cell("b", "thin", [3, 2])]).flips == ()


def test_one_draw_has_no_band_and_levels_are_no_draws() -> None:
    assert bands([cell("a", "thin", [2])], "safety_gated", ranked=["a"]) is None
    assert sweep_table("x", levels(a=("++", "+-"), b=("++", "--")), rank_by="safety_gated").bands is None
    told = as_markdown(sweep_table("x", [cell("a", "thin", [2, 3])], rank_by="safety_gated"))
    assert "## Spread over the draws" in told
