"""Zeroing, baseline and grid against presses whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import ConfigError
from carecontact.human.library import load_body
from carecontact.lab.calibration.calibrate import Fit, choose, fit_law
from carecontact.lab.calibration.checks import read_trials
from carecontact.lab.calibration.curve import TOUCH_SHARE, despiked, identify, make_curve
from carecontact.lab.calibration.problem import (
    TERMS,
    Family,
    Problem,
    agreement,
    moved_back,
    pooled,
    step_within,
    stiffness_errors,
)
from carecontact.lab.calibration.replay import Replay, group_curves
from carecontact.lab.calibration.trial import Condition, Trial
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import LARGEST_CONTACT, Tissue
from tests.lab.calibration.conftest import rows, save

CONDITION = Condition(
    indenter_shape="hemisphere", indenter_size_m=0.01, speed_m_s=0.005, along_m=0.0, across_m=0.0, tilt_deg=0.0
)


def trial(
    *, zero_m: float = 0.0, offset: float = 0.0, drift: float = 0.0, noise: float = 0.0, k: float = 800.0
) -> Trial:
    """F = k d + 5e4 d^2 from 1.5 mm outside to 5 mm and back, at 5 mm/s."""
    time = np.arange(0.0, 2.6, 0.01)
    depth = 0.005 - 0.005 * np.abs(time - 1.3)
    rng = np.random.default_rng(3)
    inside = np.maximum(depth, 0.0)
    force = k * inside + 5e4 * inside**2 + offset + drift * time + noise * rng.normal(size=len(time))
    return Trial(
        trial_id="a", site="forearm", subject="p", condition=CONDITION, preload_n=0.0, filter="none", time_s=time,
        indentation_m=depth + zero_m, force_n=force, phase=np.where(time > 1.3, 2, 0), path=Path("t.csv"), line=2,
    )  # fmt: skip


@settings(max_examples=25)
@given(
    zero_m=st.floats(-0.002, 0.002), offset=st.floats(-1, 1), drift=st.floats(-0.1, 0.1), noise=st.floats(0, 0.02)
)  # fmt: skip
def test_zero_offset_and_drift_do_not_matter(zero_m: float, offset: float, drift: float, noise: float) -> None:
    curve = make_curve(trial(zero_m=zero_m, offset=offset, drift=drift, noise=noise))
    # Where the true force is the touch force.
    f = curve.touch_force_n
    at_touch = (-800 + np.sqrt(800**2 + 4 * 5e4 * f)) / 1e5
    truth = 800 * (curve.grid_m + at_touch) + 5e4 * (curve.grid_m + at_touch) ** 2
    np.testing.assert_allclose(curve.loading_n, truth, atol=0.02 + 2.5 * noise)
    # The way out begins a sample after the deepest point.
    np.testing.assert_allclose(curve.unloading_n[:-1], truth[:-1], atol=0.02 + 2.5 * noise)
    assert curve.drift_n_s == pytest.approx(drift, abs=0.01 + noise)


def test_touch_force_is_the_largest_of_three() -> None:
    quiet = make_curve(trial())
    assert quiet.touch_force_n == pytest.approx(TOUCH_SHARE * 5.25, rel=0.03)
    noisy = make_curve(trial(noise=0.1))
    assert noisy.touch_force_n == pytest.approx(3 * noisy.noise_n)
    preloaded = Trial(**{**vars(trial()), "preload_n": 0.5})
    assert make_curve(preloaded).touch_force_n == 0.5


def test_path_keeps_its_depth_and_speed() -> None:
    curve = make_curve(trial(noise=0.01))
    assert curve.path_m.max() == pytest.approx(curve.deepest_m, abs=1.5e-4)
    np.testing.assert_allclose(curve.loading_m_s[:30], 0.005, rtol=0.05)
    np.testing.assert_allclose(curve.unloading_m_s[:30], -0.005, rtol=0.05)


def test_a_trial_without_free_motion_starts_at_its_first_force(tmp_path: Path) -> None:
    pressed = read_trials(save(tmp_path / "t.csv", rows(n=120)[30:]), region="forearm").trials[0]
    curve = make_curve(pressed)
    assert curve.noise_n < 0.01
    assert curve.touch_force_n == pytest.approx(pressed.force_n[1], rel=0.2)


def test_a_trial_that_is_all_noise_is_refused() -> None:
    with pytest.raises(ConfigError, match="preload"):
        make_curve(trial(noise=0.8))


def test_spikes_go_and_peaks_stay() -> None:
    force = 5.0 - np.abs(np.linspace(-5.0, 5.0, 101))
    spiked = force.copy()
    spiked[20] += 24.0
    spiked[60:62] -= 3.0
    out = despiked(spiked)
    assert np.abs(out - force).max() < 0.25
    np.testing.assert_array_equal(np.delete(out, [20, 60, 61]), np.delete(force, [20, 60, 61]))


# Laws identified from presses that were made with one of them.


@pytest.mark.parametrize("seed", [1, 2])
def test_hunt_crossley_is_found_with_its_exponent_and_loss(seed: int, generator: ModuleType, tmp_path: Path) -> None:
    truth = generator.make("abdomen", "analytic", tmp_path / "t.csv", seed=seed)["law"]
    curves = [make_curve(trial) for trial in read_trials(tmp_path / "t.csv", region="abdomen").trials]
    best, *others = identify(curves)
    assert best.law.name == "hunt-crossley"
    found = best.physical()
    assert found["n"] == pytest.approx(truth["n"], rel=0.06)
    assert found["beta_s_mm"] * 1000 == pytest.approx(truth["beta_s_m"], rel=0.15)
    assert best.left_out_rms is not None
    assert all(best.left_out_rms < one.left_out_rms for one in others if one.left_out_rms is not None)


def test_loading_alone_of_a_straight_line_is_linear(tmp_path: Path) -> None:
    lines = [row for k in range(4) for row in rows(f"t{k}", depth=4.0 + 0.1 * k)]
    curves = [make_curve(trial) for trial in read_trials(save(tmp_path / "t.csv", lines), region="forearm").trials]
    found = {one.law.name: one for one in identify(curves)}
    assert found["linear"].physical()["k_N_mm"] == pytest.approx(1.0, rel=0.01)
    assert found["linear"].rms < 0.01


def test_single_trial_has_no_left_out_error(analytic_csv: Path) -> None:
    curve = make_curve(read_trials(analytic_csv, region="forearm").trials[0])
    assert all(one.left_out_rms is None for one in identify([curve]))


# Which terms a law gets, on presses of the forearm without noise.


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
    tissue = load_protocol("bathing-v3").person.tissue["forearm"]
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
    tissue = load_protocol("bathing-v3").person.tissue["forearm"]
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
        self.curves, self.base, self.depth = range(10), load_protocol("bathing-v3").person.tissue["forearm"], 0.01
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


# Gauss-Newton steps within bounds, and the errors of stiffness that a fit makes small.

LOW, HIGH = np.array([-9.0, 0.0, 0.0]), np.array([9.0, 5.0, 1.0])


def test_a_step_inside_the_bounds_is_newtons() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    normal, p, want = root @ root.T, np.array([1.0, 1.0, 0.5]), np.array([0.8, 1.5, 0.4])
    np.testing.assert_allclose(step_within(p, normal, normal @ (p - want), LOW, HIGH), want, atol=1e-6)


def test_what_stops_at_a_bound_is_made_up_for() -> None:
    """The least of the quadratic within the bounds, found by looking everywhere."""
    normal = np.array([[2.0, 0.9, 0.3], [0.9, 1.0, 0.2], [0.3, 0.2, 0.8]])
    p = np.array([0.5, 0.4, 0.3])
    free = np.array([0.2, -0.7, 0.5])
    stepped = step_within(p, normal, normal @ (p - free), LOW, HIGH)
    assert stepped[1] == 0.0

    def value(q: np.ndarray) -> float:
        return float((q - free) @ normal @ (q - free))

    rng = np.random.default_rng(2)
    others = np.clip(stepped + rng.normal(scale=0.2, size=(2000, 3)), LOW, HIGH)
    assert value(stepped) <= min(map(value, others)) + 1e-9


def test_a_share_that_a_resample_holds_at_zero_stays_there() -> None:
    """Where the full step too ends at zero, taking it off would give back the optimum and hide the way down to zero."""
    optimum = np.array([1.0, 0.2, 0.5])
    full, resampled = np.array([1.1, 0.0, 0.5]), np.array([0.9, 0.0, 0.6])
    np.testing.assert_allclose(moved_back(resampled, full - optimum, LOW, HIGH), [0.8, 0.0, 0.6])


def test_the_error_of_stiffness_is_blind_to_losses(analytic_csv: Path) -> None:
    """A tenth too stiff, whatever the loop between both ways; a trial without a way back is judged by its way in."""
    curve = make_curve(read_trials(analytic_csv, region="forearm").trials[0])
    loop = 0.2 * curve.peak_n * np.sin(np.linspace(0, np.pi, len(curve.grid_m)) / 2)
    errors = stiffness_errors(curve, 1.1 * curve.loading_n + loop, 1.1 * curve.unloading_n - loop)
    np.testing.assert_allclose(errors, 0.1)
    one_way = replace(curve, trial=replace(curve.trial, phase=np.zeros_like(curve.trial.phase)))
    np.testing.assert_allclose(stiffness_errors(one_way, 1.1 * curve.loading_n, curve.unloading_n), 0.1)
    steeper = 1.1 * curve.loading_n * curve.grid_m / curve.grid_m[-1]
    end, slope = stiffness_errors(one_way, steeper, curve.unloading_n)
    assert slope > end > 0.0


# Error measures against curves whose errors are known.

DEPTH = np.linspace(0.0, 0.004, 41)
LINE, NONE = 1000 * DEPTH, np.full(41, np.nan)


def test_equal_curves_have_no_error() -> None:
    same = agreement(DEPTH, (LINE, 0.8 * LINE), (LINE, 0.8 * LINE))
    assert (same.nrmse, same.peak_error, pooled([same])["work_error"]) == (0.0, 0.0, 0.0)
    assert same.r2 == 1.0


@given(share=st.floats(-0.3, 0.3))
def test_stiffer_by_a_share(share: float) -> None:
    one = agreement(DEPTH, (LINE, 0.8 * LINE), ((1 + share) * LINE, (1 + share) * 0.8 * LINE))
    assert one.peak_error == pytest.approx(share, abs=1e-9)
    assert one.tangent_error == pytest.approx(share, abs=1e-9)
    assert pooled([one])["work_error"] == pytest.approx(share, abs=1e-9)


def test_nrmse_is_over_the_measured_peak() -> None:
    assert agreement(DEPTH, (LINE, NONE), (LINE + 0.2, NONE)).nrmse == pytest.approx(0.05)


def test_missing_legs_and_depths_are_left_out() -> None:
    cut = np.where(DEPTH <= 0.003, LINE, np.nan)
    one = agreement(DEPTH, (LINE, NONE), (cut, NONE))
    assert one.nrmse == 0.0
    assert one.work_j is None


def test_pooling() -> None:
    rows = [agreement(DEPTH, (LINE, NONE), (LINE + e, NONE)) for e in (0.0, 0.4)]
    whole = pooled(rows)
    assert whole["nrmse"] == pytest.approx(np.sqrt((0.0 + 0.1**2) / 2))
    assert whole["peak_error"] == pytest.approx(0.05)
    assert whole["work_error"] is None


def test_the_error_of_work_is_that_of_all_trials_together() -> None:
    """A thin loop that is twice too wide counts less than a wide one that is right."""
    thin = agreement(DEPTH, (LINE, 0.9 * LINE), (LINE, 0.8 * LINE))
    wide = agreement(DEPTH, (LINE, 0.5 * LINE), (LINE, 0.5 * LINE))
    assert pooled([thin, wide])["work_error"] == pytest.approx((0.2 + 0.5) / (0.1 + 0.5) - 1)


def test_a_loop_without_losses_has_an_error_all_the_same() -> None:
    """Relative to a hundredth of the work of the loading."""
    one = agreement(DEPTH, (LINE, LINE), (LINE, 0.95 * LINE))
    assert pooled([one])["work_error"] == pytest.approx(0.05 / 0.01 - 1)


# The laws that calibration chooses among.

BASE = load_protocol("bathing-v3").person.tissue["abdomen"]
FAMILY_DEPTH = 0.012


def family(*terms: str, damping: bool = True) -> Family:
    return Family(base=BASE, depth_m=FAMILY_DEPTH, damping=damping, terms=terms)


def pressure(tissue: Tissue, x: float) -> float:
    return tissue.a_n_m3 * x + tissue.b_n_m4 * x**2 + tissue.c_n_m5 * x**3


def test_every_choice_within_the_bounds_is_a_law() -> None:
    rng = np.random.default_rng(0)
    made = family(*TERMS)
    for _ in range(300):
        p = rng.uniform(made.low, made.high)
        # Tissue refuses what softens under load.
        tissue = Tissue.model_validate(made.tissue(p).model_dump())
        if tissue.a_n_m3 > 1.02 * (BASE.contact_n_m3 or 0.0) / LARGEST_CONTACT:
            assert pressure(tissue, FAMILY_DEPTH) == pytest.approx(np.exp(p[0]) * pressure(BASE, FAMILY_DEPTH))
        half = tissue.damping_ns_m3 + tissue.damping_growth_ns_m4 * FAMILY_DEPTH / 2
        assert half == pytest.approx(np.exp(p[1]))


def test_bend_softens_and_rise_stiffens() -> None:
    straight = family().tissue(np.array([0.0, 10.0]))
    assert (straight.b_n_m4, straight.c_n_m5, straight.damping_growth_ns_m4) == (0.0, 0.0, 0.0)
    bent = family("bend").tissue(np.array([0.0, 10.0, 0.6]))
    assert bent.b_n_m4 < 0
    assert pressure(bent, FAMILY_DEPTH / 4) > pressure(straight, FAMILY_DEPTH / 4)
    risen = family("rise").tissue(np.array([0.0, 10.0, 1.0]))
    assert risen.b_n_m4 == 0.0
    assert pressure(risen, FAMILY_DEPTH / 4) < pressure(straight, FAMILY_DEPTH / 4)
    grown = family("growth").tissue(np.array([0.0, 10.0, 0.5]))
    assert grown.damping_growth_ns_m4 * FAMILY_DEPTH == pytest.approx(2 * grown.damping_ns_m3)


def test_a_new_term_begins_at_the_law_without_it() -> None:
    p = np.array([0.2, 10.0])
    for term in family().candidates:
        assert family().plus(term).tissue(np.r_[p, 0.0]) == family().tissue(p)


def test_damping_that_is_not_fitted_keeps_its_ratio_and_cannot_grow() -> None:
    made = family(damping=False)
    assert made.names == ("level",)
    assert "growth" not in made.candidates
    twice = made.tissue(np.array([np.log(2.0)]))
    assert twice.damping_ns_m3 == pytest.approx(2 * BASE.damping_ns_m3)
