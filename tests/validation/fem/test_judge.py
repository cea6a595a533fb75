from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import CarecontactError
from carecontact.validation import fem
from carecontact.validation.fem import judge
from carecontact.validation.fem.cases import CASES, DEPTHS_M
from carecontact.validation.fem.ground import Medium
from carecontact.validation.fem.judge import Sample
from carecontact.validation.fem.materials import MATCHED_M, MIDDLE, PLAIN
from carecontact.validation.fem.tools import CAP, ball, disc

BELLY, FOREARM, UPPER_ARM = CASES


def test_only_the_seam_knows_the_simulator() -> None:
    for path in Path(fem.__path__[0]).glob("*.py"):
        named = {
            node.module or ""
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.ImportFrom)
        }  # fmt: skip
        knows = [name for name in named if name.startswith(("carecontact.sim", "carecontact.world", "mujoco"))]
        assert not knows or path.name == "simulated.py", path.name
        assert "carecontact.validation.fem.simulated" not in named or path.name == "compare.py", path.name


@pytest.mark.parametrize("skin", [PLAIN, MIDDLE])
def test_the_tissues_modulus_gives_the_published_force(skin) -> None:
    found = judge.matched(UPPER_ARM, skin)
    published = np.interp(MATCHED_M, UPPER_ARM.reference.depth_m, UPPER_ARM.reference.force_n)
    assert found.curve(UPPER_ARM.main).at(np.array([MATCHED_M]))[0] == pytest.approx(published, rel=0.003)
    assert 5e3 < found.medium.tissue_pa < 30e3


def test_an_impossible_force_is_an_error() -> None:
    weak = replace(FOREARM.reference, force_n=1e-6 * FOREARM.reference.force_n)
    with pytest.raises(CarecontactError):
        judge.matched(replace(FOREARM, reference=weak), MIDDLE)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
def test_half_the_patches_side_gives_the_same_forces(case) -> None:
    medium = Medium(ground=case.ground, skin=MIDDLE, tissue_pa=15e3)
    travels = np.array([0.0015, 0.004])
    for tool in (ball(0.005), case.main):
        usual, fine = (Sample(medium, refined=factor).press(tool, travels) for factor in (1.0, 2.0))
        np.testing.assert_allclose(usual, fine, rtol=0.01)


def test_finer_patches_under_a_gliding_tool_give_the_same_drag() -> None:
    medium = Medium(ground=FOREARM.ground, skin=MIDDLE, tissue_pa=2e4)
    usual, fine = (Sample(medium, refined=factor).drag(CAP, 0.003, 0.5) for factor in (1.0, 1.7))
    assert usual.stuck_n_m == pytest.approx(fine.stuck_n_m, rel=0.03)
    np.testing.assert_allclose(usual.force_n, fine.force_n, atol=0.02 * fine.force_n.max())
    np.testing.assert_allclose(usual.force_n[-1], 0.5 * usual.normal_n[-1], rtol=0.01)


def test_skin_flattens_the_exponent_widens_the_dimple_and_holds_a_tool_back() -> None:
    plain, skinned = (Sample(Medium(ground=BELLY.ground, skin=skin, tissue_pa=15e3)) for skin in (PLAIN, MIDDLE))
    growth = [
        np.log(sample.press(ball(0.02), [0.004])[0] / sample.press(ball(0.005), [0.004])[0])
        for sample in (plain, skinned)
    ]
    assert growth[1] < growth[0] - 0.1
    assert skinned.dimple(BELLY.main, 0.004)[0][3] > plain.dimple(BELLY.main, 0.004)[0][3]
    assert skinned.drag(CAP, 0.004, 0.5).stuck_n_m > 2 * plain.drag(CAP, 0.004, 0.5).stuck_n_m


def test_a_round_limb_lets_a_wide_disc_sink_more_easily() -> None:
    flat = replace(FOREARM.ground, limb_radius_m=None)
    forces = [
        Sample(Medium(ground=ground, skin=PLAIN, tissue_pa=1e4)).press(disc(0.0214), DEPTHS_M[-1:])[0]
        for ground in (flat, FOREARM.ground)
    ]
    assert forces[1] < 0.5 * forces[0]
