from __future__ import annotations

import numpy as np
import pytest

from carecontact.validation.fem import judge
from carecontact.validation.fem.answer import Answer, Curve
from carecontact.validation.fem.cases import CASES, DEPTHS_M, DIMPLE_M
from carecontact.validation.fem.compare import Comparison, Row, as_json
from carecontact.validation.fem.judge import Ground
from carecontact.validation.fem.materials import MATCHED_M, MIDDLE, PLAIN, SKINS

BELLY, FOREARM = CASES
COARSE_M = 0.002


@pytest.mark.parametrize("skin", [PLAIN, MIDDLE])
def test_the_tissues_modulus_gives_the_published_force(skin) -> None:
    ground = Ground(thickness_m=0.05, fine_m=COARSE_M)
    answer = judge.answer(BELLY, skin, ground)
    published = np.interp(MATCHED_M, BELLY.reference.depth_m, BELLY.reference.force_n)
    assert answer.curves[BELLY.main()].at(np.array([MATCHED_M]))[0] == pytest.approx(published, rel=0.003)
    assert 5e3 < answer.modulus_pa < 30e3


def test_skin_flattens_the_exponent_and_widens_the_dimple() -> None:
    ground = Ground(thickness_m=0.05, fine_m=COARSE_M)
    plain, skinned = (judge.answer(BELLY, skin, ground) for skin in (PLAIN, MIDDLE))
    assert (skinned.exponents("ball") < plain.exponents("ball") - 0.05).all()
    assert skinned.dimple(DIMPLE_M)[0] > plain.dimple(DIMPLE_M)[0]


def test_a_round_limb_lets_a_wide_disc_sink_more_easily() -> None:
    flat, round_ = (
        judge.answer(FOREARM, PLAIN, Ground(thickness_m=0.018, fine_m=COARSE_M, limb_radius_m=radius))
        for radius in (None, 0.04)
    )
    assert (round_.exponents("disc") < flat.exponents("disc")).all()


def test_not_slipping_makes_a_nearly_incompressible_layer_a_little_stiffer() -> None:
    gain = judge.sticking_gain(BELLY, PLAIN, Ground(thickness_m=0.05, fine_m=COARSE_M))
    assert 1.0 <= gain < 1.1


def power(exponent: float, scale: float = 1.0) -> Answer:
    """Force = scale r^exponent d, and a dimple that sinks by a fifth of the travel everywhere."""
    depth = np.linspace(0.0, 0.006, 200)
    curves = {
        name: Curve(presses=((depth, scale * 1e6 * ((i.size_m or 0.01) ** exponent) * depth),))
        for name, i in BELLY.indenters().items()
    }
    at = np.array([0.0, 0.03])
    return Answer(curves=curves, dimple_m=np.full(2, 0.0008), dimple_at_m=at, dimple_travel_m=0.004)


def test_an_exponent_is_read_off_the_names_of_the_indenters() -> None:
    # Sizes in the names are rounded to a tenth of a millimetre, 5.35 mm to 5.3.
    np.testing.assert_allclose(power(0.7).exponents("disc"), 0.7, rtol=0.02)


def test_a_curve_counts_depth_from_each_press_own_touch() -> None:
    depth = np.linspace(0.0, 0.006, 601)
    late = np.maximum(depth - 0.001, 0.0)
    curve = Curve(presses=((depth, 100 * depth), (depth, 100 * late)))
    np.testing.assert_allclose(curve.at(DEPTHS_M, touch_n=0.02), 100 * DEPTHS_M + 0.02, rtol=1e-3)


def row(simulated: float) -> Row:
    return Row(region="abdomen", name="n", unit="", skins=(2.0, 1.0, 3.0), plain=4.0, simulated=simulated)


@pytest.mark.parametrize(
    ("simulated", "outside", "agrees"),
    [(2.5, 0.0, True), (3.2, 20 / 3, True), (0.8, 20.0, False), (4.0, 100 / 3, False)],
)
def test_agreement_is_within_a_tenth_of_the_nearest_end_of_the_skins(simulated, outside, agrees) -> None:
    assert row(simulated).outside_percent == pytest.approx(outside)
    assert row(simulated).agrees == agrees


def test_the_record_has_every_row_and_every_skin() -> None:
    done = Comparison(
        case=BELLY, ground=Ground(thickness_m=0.05), plain=power(0.6), skins=tuple(power(0.5) for _ in SKINS),
        simulated=power(0.5), extras={"x": 1.0},
    )  # fmt: skip
    record = as_json([done])
    rows = record["regions"]["abdomen"]["rows"]  # type: ignore[index]
    assert len(rows) == len(done.rows()) > 15
    assert all(len(r["skins"]) == len(SKINS) and r["outside_percent"] == 0 for r in rows)
