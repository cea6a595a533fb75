from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

from carecontact.validation.fem import judge, table
from carecontact.validation.fem.cases import CASES
from carecontact.validation.fem.materials import MIDDLE, MODULUS_PA, SKINS, THICKNESS_M
from carecontact.validation.fem.quantities import quantities
from carecontact.validation.fem.table import FILE, as_text, made, standards
from tests.validation.fem.made_up import power


def test_the_stored_table_has_every_quantity_of_every_region_in_a_few_kilobytes() -> None:
    expected = [(case.region, quantity.name, quantity.unit) for case in CASES for quantity in quantities(case)]
    assert [(s.region, s.name, s.unit) for s in standards()] == expected
    assert all(len(s.skins) == len(SKINS) for s in standards())
    assert len((files("carecontact.validation.fem") / FILE).read_bytes()) < 20_000


def test_the_stored_table_tells_what_it_was_made_of() -> None:
    stored = json.loads((files("carecontact.validation.fem") / FILE).read_text())
    for skin in SKINS:
        held = stored["skins"][skin.name]
        assert (held["thickness_m"], held["modulus_pa"]) == (skin.thickness_m, skin.modulus_pa)
        assert skin.thickness_m in THICKNESS_M
        assert skin.modulus_pa in MODULUS_PA
    for case in CASES:
        held = stored["regions"][case.region]
        assert held["published"] == case.reference.name
        assert (held["thickness_m"], held["limb_radius_m"]) == (case.ground.thickness_m, case.ground.limb_radius_m)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
def test_the_stored_table_is_what_the_judge_says_today(case) -> None:
    found = judge.answer(case, MIDDLE)
    stored = [s for s in standards() if s.region == case.region]
    here = [quantity.of(found) for quantity in quantities(case)]
    # Percentages are told in points.
    np.testing.assert_allclose(here, [s.skins[SKINS.index(MIDDLE)] for s in stored], rtol=0.005, atol=0.005)


def test_a_table_is_read_as_it_was_written(monkeypatch, tmp_path) -> None:
    found = {c.region: (power(c, 0.6, scale=50), tuple(power(c, 0.5, scale=50 + k) for k in range(5))) for c in CASES}
    (tmp_path / FILE).write_text(as_text(found))
    monkeypatch.setattr(table, "files", lambda package: tmp_path)
    assert standards() == [standard for case in CASES for standard in made(case, *found[case.region])]
