"""Which terms a law gets, on presses of the forearm without noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from carecontact.calibration.agreement import pooled
from carecontact.calibration.checks import read_trials
from carecontact.calibration.curve import make_curve
from carecontact.calibration.family import Family
from carecontact.calibration.fit import Fit, choose, fit_law
from carecontact.calibration.problem import Problem
from carecontact.calibration.replay import Replay, group_curves
from carecontact.protocols import load_protocol
from carecontact.world.human.library import load_body
from tests.calibration.conftest import save


def fitted(path: Path, exponent: float, *, trials: int = 4) -> Fit:
    """Loading with a ball: 4 N at 4 mm, as this power of depth, a few percent apart."""
    lines = []
    for number in range(trials):
        travel = np.linspace(-1.0, 4.0, 120)
        force = 4.0 * (1 + 0.02 * (number - 1.5)) * (np.maximum(travel, 0.0) / 4.0) ** exponent
        lines += [
            f"t{number},forearm,p{number},{(d + 1) / 10:.5f},{d:.5f},{f:.5f},load,10,hemisphere,10,0,none"
            for d, f in zip(travel, force, strict=True)
        ]
    curves = [make_curve(trial) for trial in read_trials(save(path, lines), region="forearm").trials]
    tissue = load_protocol().person.tissue["forearm"]
    replay = Replay(body=load_body("man-adult"), region="forearm", tissue=tissue, groups=group_curves(curves))
    return fit_law(curves, replay=replay)


@pytest.mark.parametrize("exponent", [1.3, 2.2])
def test_the_law_bends_as_the_response_does(exponent: float, tmp_path: Path) -> None:
    """On straight anchors a ball meets about d^1.5: what is straighter needs b below zero, what is steeper more."""
    fit = fitted(tmp_path / "t.csv", exponent)
    assert "growth" not in fit.terms, "nothing unloads"
    steeper = 2 * fit.tissue.b_n_m4 + 3 * fit.tissue.c_n_m5 * 0.004
    assert fit.tissue.b_n_m4 < 0 if exponent < 1.5 else steeper > 0
    errors = pooled(fit.agreement)
    assert errors["tangent_error"] == pytest.approx(0.0, abs=0.05)
    assert errors["nrmse"] == pytest.approx(0.0, abs=0.04)


def test_too_few_trials_choose_nothing(tmp_path: Path) -> None:
    fit = fitted(tmp_path / "t.csv", 1.3, trials=2)
    assert fit.terms == ("rise",)
    assert fit.tissue.b_n_m4 == 0.0
    assert fit.chosen == ("too few trials to choose the law's terms",)


def test_where_no_law_follows_the_forces_stiffness_does_not_pay_for_it(tmp_path: Path) -> None:
    """Hardly any law lets a ball meet a straight line. By forces alone, the tangent would be a fifth too high."""
    errors = pooled(fitted(tmp_path / "t.csv", 1.05).agreement)
    assert errors["tangent_error"] == pytest.approx(0.0, abs=0.1)
    assert errors["peak_error"] == pytest.approx(0.0, abs=0.1)


def two_speeds(path: Path) -> Problem:
    """One press of the forearm at each of two speeds, with a loss in proportion to force and speed."""
    lines = []
    for speed in (3.0, 10.0):
        there = np.linspace(-1.0, 4.0, 120)
        travel = np.r_[there, there[::-1]]
        loss = 0.02 * speed * np.repeat([1.0, -1.0], 120)
        force = 4.0 * (np.maximum(travel, 0.0) / 4.0) ** 1.5 * (1 + loss)
        lines += [
            f"t{speed:g},forearm,p,{k * 5 / 119 / speed:.5f},{d:.5f},{f:.5f},{'load' if k < 120 else 'unload'},"
            f"{speed:g},hemisphere,10,0,none"
            for k, (d, f) in enumerate(zip(travel, force, strict=True))
        ]
    curves = [make_curve(trial) for trial in read_trials(save(path, lines), region="forearm").trials]
    tissue = load_protocol().person.tissue["forearm"]
    replay = Replay(body=load_body("man-adult"), region="forearm", tissue=tissue, groups=group_curves(curves))
    return Problem(curves, replay, lambda line: None)


def test_the_levelled_law_loses_as_much_work_as_the_trials(tmp_path: Path) -> None:
    """Whatever damping the forces alone ask for: friction loses work too, and no fit changes it."""
    problem = two_speeds(tmp_path / "t.csv")
    family = Family(base=problem.base, depth_m=problem.depth, damping=True)
    found = problem.solve(family, problem.start(family))
    found.p[family.names.index("damping")] += 0.4
    _, before = problem.errors(family.tissue(found.p))
    levelled = problem.levelled(found)
    _, after = problem.errors(family.tissue(levelled.p))
    assert before > 0.15
    assert abs(after) < 0.02


@dataclass
class Seen:
    """A solution, or a step towards one (``tried`` is then False)."""

    family: Family
    tried: bool = True

    def step(self, weights: np.ndarray) -> np.ndarray:
        return np.zeros(len(self.family.names))


class Promises:
    """A problem whose first step promises most of ``rise``, while only ``growth`` helps a law that bends."""

    speeds_apart = 1.0

    HELD_OUT: ClassVar = {(): 1.0, ("bend",): 0.5, ("bend", "rise"): 0.499, ("bend", "growth"): 0.2}
    PROMISED: ClassVar = {("bend",): 0.5, ("bend", "rise"): 0.3, ("bend", "growth"): 0.4}

    def __init__(self) -> None:
        self.curves, self.base, self.depth = range(10), load_protocol().person.tissue["forearm"], 0.01
        self.solved: list[tuple[str, ...]] = []

    def on_progress(self, line: str) -> None:
        pass

    def start(self, family: Family) -> np.ndarray:
        return np.zeros(2)

    def solve(self, family: Family, start: np.ndarray) -> Seen:
        self.solved.append(family.terms)
        return Seen(family)

    def with_term(self, found: Seen, term: str) -> Seen:
        return Seen(found.family.plus(term), tried=False)

    def held_out_squares(self, seen: Seen) -> np.ndarray:
        of = self.HELD_OUT if seen.tried else self.PROMISED
        return np.full(10, of.get(seen.family.terms, 0.9 if len(seen.family.terms) == 1 else 0.199))


def test_a_term_that_stays_out_does_not_keep_the_others_from_being_tried() -> None:
    problem = Promises()
    found, lines = choose(problem, damping=True)  # pyright: ignore[reportArgumentType]
    assert found.family.terms == ("bend", "growth")
    assert [line.split(":")[0] for line in lines] == [
        "bend enters", "rise stays out", "growth enters", "rise stays out"
    ]  # fmt: skip
    assert problem.solved == [(), ("bend",), ("bend", "rise"), ("bend", "growth")], "the last promised nothing"


class Apart(Promises):
    """Three speeds: no step promises anything of ``growth``, and it makes the tangents at each speed right."""

    speeds_apart = 3.0
    HELD_OUT: ClassVar = {(): 1.0}
    PROMISED: ClassVar = {}
    after = 0.001

    def held_out_squares(self, seen: Seen) -> np.ndarray:
        return np.full(10, 1.0)

    def held_out_tangent_squares(self, seen: Seen) -> np.ndarray:
        return np.full(10, self.after if seen.family.terms else 0.01)


@pytest.mark.parametrize(("after", "terms"), [(0.001, ("growth",)), (0.0099, ()), (0.02, ())])
def test_growth_is_always_tried_on_several_speeds_and_chosen_by_their_tangents(
    after: float, terms: tuple[str, ...]
) -> None:
    problem = Apart()
    problem.after = after
    found, lines = choose(problem, damping=True)  # pyright: ignore[reportArgumentType]
    assert found.family.terms == terms
    assert ("growth",) in problem.solved
    assert any(
        line.startswith(f"growth {'enters' if terms else 'stays out'}: held-out error of the tangents per speed 10.00%")
        for line in lines
    )


def test_the_predicted_tangents_are_those_of_replays(tmp_path: Path) -> None:
    """Of one fold's own law, to what the Jacobian leaves out; at each speed they have the sign of its mean error."""
    problem = two_speeds(tmp_path / "t.csv")
    family = Family(base=problem.base, depth_m=problem.depth, damping=True)
    found = problem.solve(family, problem.start(family))
    held = np.array([one.tangent_error for one in problem.held_out(found)])
    np.testing.assert_allclose(problem.held_out_tangent_squares(found), held**2, rtol=0.1, atol=1e-4)
