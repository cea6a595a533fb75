from __future__ import annotations

import importlib.util
import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from carecontact.errors import CarecontactError
from carecontact.interface.robot import PANDA
from carecontact.lab.fem import simulated, solve
from carecontact.lab.fem.cases import (
    CAP,
    CASES,
    DEPTHS_M,
    EDGE_M,
    MIDDLE,
    MODULUS_PA,
    RINGS_M,
    SKINS,
    STEEPEST,
    THICKNESS_M,
    TOUCH_N,
    Curve,
    ball,
    disc,
    rings,
    touch_m,
)
from carecontact.lab.fem.compare import (
    Comparison,
    Row,
    Standard,
    as_json,
    draw,
    made,
    quantities,
)
from carecontact.lab.validation.rig import person_bench
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.load import load_protocol
from tests.lab.fem.made_up import power

_SPEC = importlib.util.spec_from_file_location("fem_table", Path(__file__).parents[3] / "tools" / "fem_table.py")
assert _SPEC is not None
assert _SPEC.loader is not None
fem_table = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(fem_table)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
@pytest.mark.parametrize("word", ["ball", "disc"])
def test_an_exponent_is_the_slope_over_the_three_sizes(case, word) -> None:
    np.testing.assert_allclose(power(case, 0.7, scale=100).exponents(case, word), 0.7, rtol=0.02)


def test_a_curve_counts_depth_from_each_press_own_touch() -> None:
    depth = np.linspace(0.0, 0.006, 601)
    late = np.maximum(depth - 0.001, 0.0)
    curve = Curve(presses=((depth, 100 * depth), (depth, 100 * late)))
    np.testing.assert_allclose(curve.at(DEPTHS_M, touch_n=0.02), 100 * DEPTHS_M + 0.02, rtol=1e-3)
    assert curve.touch_m(0.02) == pytest.approx(0.0007, rel=1e-3)


def test_touch_lies_between_samples_and_has_to_come() -> None:
    travel = np.array([0.0, 0.001, 0.002])
    assert touch_m(travel, np.array([0.0, 0.01, 0.03]), 0.02) == pytest.approx(0.0015)
    with pytest.raises(CarecontactError, match="never exceeds"):
        touch_m(travel, np.zeros(3), 0.02)


def test_a_ring_is_the_mean_about_its_distance() -> None:
    places = np.array([[0.003, 0.0], [0.0, 0.005], [0.0201, 0.001]])
    sunk = np.array([1.0, 3.0, 5.0])
    found = rings(places, sunk)
    assert rings(places, sunk, beside=True)[0] == 1.0
    assert found[0] == 2.0
    assert found[list(np.round(1000 * RINGS_M)).index(20)] == 5.0
    assert np.isnan(found[list(np.round(1000 * RINGS_M)).index(12)])


def test_a_ball_is_a_ball_and_goes_on_as_a_cone() -> None:
    r, zero = np.array([0.0, 0.003, 0.006]), np.zeros(3)
    np.testing.assert_allclose(ball(0.01).height(r, zero), 0.01 - np.sqrt(0.01**2 - r**2))
    np.testing.assert_allclose(ball(0.01).height(zero, r), ball(0.01).height(r, zero))
    outside = ball(0.01).height(np.array([0.011, 0.012]), np.zeros(2))
    assert np.diff(outside)[0] == pytest.approx(STEEPEST * 0.001)


def test_the_cap_is_the_robots_ellipsoid_lying_across() -> None:
    along, across, up = PANDA.tip.half_m
    assert across > along
    height = CAP.height(np.array([along * 0.6, 0.0]), np.array([0.0, across * 0.6]))
    np.testing.assert_allclose(height, up * (1 - 0.8))


def test_a_disc_has_a_flat_face_and_a_round_rim() -> None:
    height = disc(0.01).height(np.array([0.0, 0.004, 0.008, 0.009]), np.zeros(4))
    rim = EDGE_M - np.sqrt(EDGE_M**2 - 0.001**2)
    np.testing.assert_allclose(height, [0.0, 0.0, 0.0, rim], atol=1e-12)


@pytest.mark.parametrize("tool", [ball(0.01), ball(0.02), CAP])
def test_nothing_lies_under_a_tool_beyond_its_reach(tool) -> None:
    turn = np.linspace(0, 2 * np.pi, 50)
    for factor, inside in ((0.97, True), (1.01, False)):
        r = factor * tool.reach_m(0.004)
        assert (tool.height(r * np.cos(turn), r * np.sin(turn)) < 0.004).any() == inside


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


def test_every_region_has_a_row_of_panels_and_one_legend_tells_the_lines() -> None:
    done = [
        Comparison(case=case, plain=power(case, 0.6), skins=tuple(power(case, 0.5) for _ in SKINS),
                   simulated=power(case, 0.7), extras={})
        for case in CASES
    ]  # fmt: skip
    figure = Figure(layout="constrained")
    draw(done, figure)
    assert len(figure.axes) == 15
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["finite elements, all skins", "middle skin", "no skin", "simulator", "people, middle"]
    figure.savefig(BytesIO(), format="png")


def test_the_stored_table_has_every_quantity_of_every_region_in_a_few_kilobytes() -> None:
    expected = [(case.region, quantity.name, quantity.unit) for case in CASES for quantity in quantities(case)]
    assert [(s.region, s.name, s.unit) for s in fem_table.standards()] == expected
    assert all(len(s.skins) == len(SKINS) for s in fem_table.standards())
    assert len(fem_table.FILE.read_bytes()) < 20_000


def test_the_stored_table_tells_what_it_was_made_of() -> None:
    stored = json.loads(fem_table.FILE.read_text())
    for skin in SKINS:
        held = stored["skins"][skin.name]
        assert (held["thickness_m"], held["modulus_pa"]) == (skin.thickness_m, skin.modulus_pa)
        assert skin.thickness_m in THICKNESS_M
        assert skin.modulus_pa in MODULUS_PA
    for case in CASES:
        held = stored["regions"][case.region]
        assert held["published"] == case.reference.name
        assert (held["thickness_m"], held["limb_radius_m"]) == (case.ground.thickness_m, case.ground.limb_radius_m)


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=c.region, marks=[pytest.mark.slow] * (c.region != "abdomen")) for c in CASES],
)
def test_the_stored_table_is_what_the_judge_says_today(case) -> None:
    found = solve.answer(case, MIDDLE)
    stored = [s for s in fem_table.standards() if s.region == case.region]
    here = [quantity.of(found) for quantity in quantities(case)]
    # Percentages are in points.
    np.testing.assert_allclose(here, [s.skins[SKINS.index(MIDDLE)] for s in stored], rtol=0.005, atol=0.005)


def test_a_table_is_read_as_it_was_written(monkeypatch, tmp_path) -> None:
    found = {c.region: (power(c, 0.6, scale=50), tuple(power(c, 0.5, scale=50 + k) for k in range(5))) for c in CASES}
    monkeypatch.setattr(fem_table, "FILE", tmp_path / "standards.json")
    fem_table.FILE.write_text(fem_table.as_text(found))
    assert fem_table.standards() == [standard for case in CASES for standard in made(case, *found[case.region])]


SIMULATED_BELLY, FOREARM, _ = CASES


@pytest.fixture(scope="module")
def subject() -> Subject:
    return Subject(load_protocol("bathing-v3"))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
def test_the_references_ground_is_that_of_the_protocols_person(subject: Subject, case) -> None:
    found = simulated.ground(subject, case)
    assert found.thickness_m == case.ground.thickness_m
    if case.ground.limb_radius_m is None:
        assert found.limb_radius_m is None
    else:
        assert found.limb_radius_m == pytest.approx(case.ground.limb_radius_m, rel=0.01)


def test_a_tools_twin_on_the_bench_has_its_shape() -> None:
    assert simulated.indenter(CAP).shape == "cap"
    assert (simulated.indenter(ball(0.01)).shape, simulated.indenter(ball(0.01)).size_m) == ("hemisphere", 0.01)
    assert (simulated.indenter(disc(0.02)).shape, simulated.indenter(disc(0.02)).size_m) == ("flat", 0.02)


def test_a_tool_that_glides_drags_with_its_friction_and_a_glued_one_with_more(subject: Subject) -> None:
    bench = person_bench(subject, "forearm", simulated.indenter(CAP), glides=True)
    way = np.array([0.0, 0.0005, 0.003])
    tangential, normal = simulated._glide(bench, (0.016, -0.007), 0.003, way)
    assert tangential[0] == 0.0
    assert 0 < tangential[1] < tangential[2]
    # Pushes lean back on the tool's front.
    assert 0.45 < tangential[2] / normal[2] < 0.65
    assert normal[2] > 10 * TOUCH_N
    simulated.friction_of(bench)[:] = simulated.GLUE
    glued, _ = simulated._glide(bench, (0.016, -0.007), 0.003, way)
    assert glued[2] > 1.5 * tangential[2]
