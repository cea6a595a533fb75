"""The second method: quadratic hexahedra against Fourier series, and against finer hexahedra."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.validation import fem
from carecontact.validation.fem.cases import CASES
from carecontact.validation.fem.ground import Medium
from carecontact.validation.fem.hexahedra import Block
from carecontact.validation.fem.judge import MARGIN, Sample
from carecontact.validation.fem.materials import MIDDLE, PLAIN

TRAVELS_M = np.array([0.002, 0.004])


@pytest.mark.parametrize(("case", "skin"), [*((case, MIDDLE) for case in CASES), (CASES[1], PLAIN)])
def test_two_methods_give_the_same_force(case, skin) -> None:
    medium = Medium(ground=case.ground, skin=skin, tissue_pa=15e3)
    block = Block(medium, MARGIN * case.main.reach_m(0.004) + 0.001, side_m=0.004)
    force = [block.press(case.main, float(travel)) for travel in TRAVELS_M]
    # Elements of 4 mm: finer ones come closer, below.
    np.testing.assert_allclose(force, Sample(medium).press(case.main, TRAVELS_M), rtol=0.025)


def test_finer_hexahedra_come_closer() -> None:
    forearm = CASES[1]
    medium = Medium(ground=forearm.ground, skin=MIDDLE, tissue_pa=15e3)
    (exact,) = Sample(medium).press(forearm.main, TRAVELS_M[1:])
    off = [abs(Block(medium, 0.0125, side_m=side).press(forearm.main, 0.004) / exact - 1) for side in (0.006, 0.003)]
    assert off[1] < 0.006
    assert off[1] < off[0]


def test_without_scikit_fem_the_command_says_what_installs_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # What is imported anew is forgotten afterwards.
    monkeypatch.setattr(sys.modules["carecontact.validation"], "fem", fem)
    for name in [n for n in sys.modules if n.split(".")[0] == "skfem" or "validation.fem" in n]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(SystemExit) as exit_:
        raise SystemExit(main(["validate", "--fem"]))
    assert exit_.value.code != 0
    told = capsys.readouterr()
    assert "pip install 'carecontact[fem]'" in told.out + told.err
    assert "Traceback" not in told.out + told.err
