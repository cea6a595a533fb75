"""How much people's tissue differs: the published percentiles, as a seed draws them."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.protocol import Tissue
from carecontact.protocols import load_protocol
from carecontact.validation.reference import ABDOMEN, FOREARM, UPPER_ARM_ANTERIOR, Reference
from carecontact.world.human.spread import SPREADS, WIDEST, draw_tissue

ROWS = load_protocol().person.tissue
FEW, MANY = 40, 4000


def factors(count: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    drawn = [draw_tissue(rng, ROWS) for _ in range(count)]
    return {name: np.array([row[name].a_n_m3 for row in drawn]) / ROWS[name].a_n_m3 for name in drawn[0]}


@pytest.mark.parametrize("reference", [FOREARM, UPPER_ARM_ANTERIOR, ABDOMEN], ids=lambda r: r.region)
def test_the_quantiles_are_the_sources(reference: Reference) -> None:
    """Of 4,000 draws, the 5th and 95th percentile have a standard error of some 2 percent of the spread."""
    low, middle, high = (curve[-1] for curve in (reference.low_n, reference.force_n, reference.high_n))
    spread = SPREADS[reference.region]
    assert (spread.p5, spread.p95) == pytest.approx((low / middle, high / middle), rel=1e-3)
    found = np.quantile(factors(MANY)[reference.region], [0.05, 0.5, 0.95])
    np.testing.assert_allclose(found, [spread.p5, 1.0, spread.p95], rtol=0.04)


def test_a_person_is_soft_on_the_whole_arm_and_on_the_belly_by_another_draw() -> None:
    found = {name: np.log(values) for name, values in factors(FEW).items()}
    np.testing.assert_array_equal(np.sign(found["forearm"]), np.sign(found["upper_arm"]))
    assert abs(np.corrcoef(found["forearm"], found["abdomen"])[0, 1]) < 0.5


def test_every_draw_can_be_a_row_of_tissue() -> None:
    """The widest draws too: convex, and with a contact layer that can be solved."""
    for spread in SPREADS.values():
        assert spread.factor(-9) == spread.factor(-WIDEST) < spread.p5 < 1 < spread.p95 < spread.factor(WIDEST)
        assert spread.factor(0.0) == 1.0
    rng = np.random.default_rng(0)
    for _ in range(FEW):
        for row in draw_tissue(rng, ROWS).values():
            Tissue.model_validate(row.model_dump())


def test_a_region_without_published_spread_keeps_its_tissue() -> None:
    assert "right_hand" not in draw_tissue(np.random.default_rng(0), {**ROWS, "right_hand": ROWS["forearm"]})
