from __future__ import annotations

import pytest

from carecontact.validation.fem.cases import CASES
from carecontact.validation.fem.compare import Comparison, Row, as_json
from carecontact.validation.fem.materials import SKINS
from carecontact.validation.fem.table import Standard
from tests.validation.fem.made_up import power

BELLY = CASES[0]


def row(simulated: float, unit: str = "") -> Row:
    standard = Standard(region="abdomen", name="n", unit=unit, skins=(2.0, 1.0, 3.0), plain=4.0)
    return Row(standard=standard, simulated=simulated)


@pytest.mark.parametrize(
    ("simulated", "outside", "agrees"),
    [(2.5, 0.0, True), (3.2, 20 / 3, True), (0.8, 20.0, False), (4.0, 100 / 3, False)],
)
def test_agreement_is_within_a_tenth_of_the_nearest_end_of_the_skins(simulated, outside, agrees) -> None:
    assert row(simulated).outside_percent == pytest.approx(outside)
    assert row(simulated).agrees == agrees


def test_percentages_are_compared_by_their_difference() -> None:
    assert row(9.0, "%").outside_percent == pytest.approx(6.0)
    assert row(-12.0, "%").outside_percent == pytest.approx(13.0)


def test_the_record_has_every_row_and_every_skin() -> None:
    done = Comparison(
        case=BELLY, plain=power(BELLY, 0.6, scale=0.002), skins=tuple(power(BELLY, 0.5, scale=0.002) for _ in SKINS),
        simulated=power(BELLY, 0.5, scale=0.002), extras={"x": 1.0},
    )  # fmt: skip
    record = as_json([done])
    rows = record["regions"]["abdomen"]["rows"]  # type: ignore[index]
    assert len(rows) == len(done.rows()) > 40
    assert all(len(r["skins"]) == len(SKINS) for r in rows)
    # Stored numbers have four digits.
    assert all(r["outside_percent"] < 0.1 for r in rows)
