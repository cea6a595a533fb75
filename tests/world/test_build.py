"""Tissue by build: thickness and law of slim and heavy bodies follow from a row that is of man-adult."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.protocol import Tissue
from carecontact.protocols import load_protocol, overridden
from carecontact.regions import STANDARD_REGIONS
from carecontact.world.human.build import GROWTH, rounded_bmi, stiffened, tissue_of
from carecontact.world.human.library import load_body
from carecontact.world.scene import build_scene

ROWS = load_protocol().person.tissue


@pytest.mark.parametrize("region", STANDARD_REGIONS)
def test_man_adult_keeps_the_rows_and_others_have_their_own(region: str) -> None:
    row = ROWS[region]
    assert tissue_of(load_body("man-adult"), region, row) is row
    slim, heavy = (tissue_of(load_body(name), region, row) for name in ("woman-old-light", "woman-old-heavy"))
    assert slim.thickness_m < row.thickness_m < heavy.thickness_m
    assert slim.a_n_m3 > row.a_n_m3 > heavy.a_n_m3
    assert heavy.thickness_m == pytest.approx(row.thickness_m + (32.0 - 22.6) * GROWTH[region].thickness_m)
    fields = ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3", "thickness_m", "bmi_kg_m2")
    same = row.model_dump(exclude=set(fields))
    assert heavy.model_dump(exclude=set(fields)) == same, "only law and thickness follow the build"
    Tissue.model_validate(heavy.model_dump())
    assert tissue_of(load_body("man-old-heavy"), region, heavy) == heavy, "a row that is of this build stays"


def test_rows_without_a_build_and_other_regions_are_the_same_on_every_body() -> None:
    heavy = load_body("man-adult-heavy")
    plain = ROWS["forearm"].model_copy(update={"bmi_kg_m2": None})
    assert tissue_of(heavy, "forearm", plain) is plain
    assert tissue_of(heavy, "right_thigh", ROWS["forearm"]) is ROWS["forearm"]


def test_beyond_the_published_builds_tissue_grows_no_further() -> None:
    row = ROWS["abdomen"].model_copy(update={"bmi_kg_m2": 60.0})
    heaviest = ROWS["abdomen"].model_copy(update={"bmi_kg_m2": 40.0})
    body = load_body("man-adult")
    assert tissue_of(body, "abdomen", row) == tissue_of(body, "abdomen", heaviest)
    assert rounded_bmi(body) == 22.6


def test_a_stiffened_law_is_as_far_from_critical_and_as_convex() -> None:
    row = ROWS["abdomen"]
    for factor in (0.3, 1.0, 3.0):
        made = stiffened(row, factor)
        depth = np.linspace(0, 0.03, 7)
        law, before = (r.a_n_m3 * depth + r.b_n_m4 * depth**2 + r.c_n_m5 * depth**3 for r in (made, row))
        np.testing.assert_allclose(law, factor * before, rtol=1e-12)
        assert made.damping_ns_m3 / row.damping_ns_m3 == pytest.approx((made.a_n_m3 / row.a_n_m3) ** 0.5)
        assert made.b_n_m4**2 / (made.a_n_m3 * made.c_n_m5) == pytest.approx(row.b_n_m4**2 / (row.a_n_m3 * row.c_n_m5))


def test_the_world_has_the_tissue_of_its_body() -> None:
    rules = overridden(load_protocol(), {"person.body": "man-adult-heavy"})
    scene = build_scene(rules, target=None, skin=False)
    for name, region in scene.regions.items():
        assert region.tissue == tissue_of(scene.body, name, rules.person.tissue[name])
        assert region.tissue.thickness_m > rules.person.tissue[name].thickness_m
