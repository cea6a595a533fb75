"""Fits the anchor law to replayed trials: bounded least squares, terms chosen by held-out error, intervals from
resampled trials.

It uses scipy's least_squares and not mujoco.sysid, which fits recorded sequences of controls and sensors with equal
time stamps and needs further packages. Here, the residual is force over depth past touch, which both sides find by
force; the rollout is a prescribed motion; and the intervals need the Jacobian afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from carecontact.calibration.agreement import Agreement
from carecontact.calibration.curve import Curve
from carecontact.calibration.family import Family
from carecontact.calibration.problem import FOLDS, Problem, Solution, agreements
from carecontact.calibration.replay import Replay, Replayed
from carecontact.calibration.trial import Array
from carecontact.contract.protocol import Tissue

LAW = ("a_n_m3", "b_n_m4", "c_n_m5")
DAMPING = ("damping_ns_m3", "damping_growth_ns_m4")
BOOTSTRAPS = 2000
BOOTSTRAP_SEED = 20250101
MIN_LOOP = 0.5
"""Damping counts as identified if half the width of its interval is below this share of its value."""
LEAST_TRIALS = 3
"""Least number of trials with which a term can be chosen; with fewer, the law keeps ``UNCHOSEN``."""
UNCHOSEN = ("rise",)
SPEEDS_APART = 3.0
"""If the fastest speed is at least this many times the slowest, ``growth`` is always tried, and the errors of the
tangents at each speed decide about it: damping that grows with depth steepens fast presses more than slow ones."""
LEAST_GAIN = 0.02
"""A term is added only if it lowers the held-out squared error by at least this share."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    tissue: Tissue
    terms: tuple[str, ...]
    """Chosen terms of ``family.TERMS``, in the order in which they were added."""
    chosen: tuple[str, ...]
    """One line in words for each choice of a term."""
    damping_identified: bool
    damping_reason: str
    replayed: list[Replayed]
    agreement: list[Agreement]
    """Agreement of each trial, in their order, with the law that was fitted to all trials."""
    held_out: list[Agreement] | None
    """Agreement of each trial with a law that was fitted without the trial's fold; None for a single trial."""
    draws: list[Tissue] | None
    """Laws fitted to resampled trials; None for a single trial."""
    secant_draws: Array | None
    """(draws, 2) relative change of the mean simulated secant stiffness and of the tangent over the deeper half"""
    evaluations: int


def fit_law(
    curves: Sequence[Curve],
    *,
    replay: Replay,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Fit:
    """Fit stiffness and, if trials unload, damping, with those terms that lower the error on held-out trials.

    If no trial unloads, or the trials do not determine the damping, damping keeps its ratio to stiffness, and the
    result says why.
    """
    problem = Problem(curves, replay, on_progress)
    unloads = any(curve.trial.unloads for curve in curves)
    reason = "fitted" if unloads else "no trial unloads"
    found, chosen = choose(problem, damping=unloads)
    draws = _draws(problem, found)
    if unloads and draws is None:
        reason = "fitted to a single trial, which gives it no interval"
    if unloads and draws is not None:
        half = _half_width(draws[:, found.family.names.index("damping")])
        if half > MIN_LOOP:
            unloads = False
            reason = f"its interval is +-{half:.0%}: the loops between loading and unloading are too thin"
            found, chosen = choose(problem, damping=False)
    found = problem.levelled(found)
    draws = _draws(problem, found)
    replay.forget()
    final = problem.at(found.family.tissue(found.p))
    held = None
    if len(curves) > 1:
        on_progress(f"held-out trials in {min(FOLDS, len(curves))} folds")
        held = problem.held_out(found)
    return Fit(
        tissue=found.family.tissue(found.p),
        terms=found.family.terms,
        chosen=chosen,
        damping_identified=unloads,
        damping_reason=reason,
        replayed=[one for one in final if one is not None],
        agreement=agreements(curves, replay.groups, final),
        held_out=held,
        draws=None if draws is None else [found.family.tissue(q) for q in draws],
        secant_draws=None if draws is None else problem.stiffness_change(found, draws),
        evaluations=problem.evaluations,
    )


def choose(problem: Problem, *, damping: bool) -> tuple[Solution, tuple[str, ...]]:
    """Add terms one by one while the error on held-out trials falls by more than its standard error.

    A Gauss-Newton step decides in which order the terms are tried, and a fit of its own whether one is added. The
    search ends when every term has stayed out, because the step does not always tell which of them helps most. A term
    from which the step promises less than ``LEAST_GAIN`` is not tried. For ``growth``, see ``SPEEDS_APART``.
    """
    family = Family(base=problem.base, depth_m=problem.depth, damping=damping)
    found = problem.solve(family, problem.start(family))
    if len(problem.curves) < LEAST_TRIALS:
        for term in UNCHOSEN:
            found = problem.solve(found.family.plus(term), np.r_[found.p, 0.1])
        return found, ("too few trials to choose the law's terms",)
    lines: list[str] = []
    while (tried := _next(problem, found, lines)) is not None:
        found = tried
    return found, tuple(lines)


def _next(problem: Problem, found: Solution, lines: list[str]) -> Solution | None:
    """Return the law with the first term that enters, or None where every term stays out; adds a line for each term."""
    now = problem.held_out_squares(found)
    ahead = [problem.with_term(found, term) for term in found.family.candidates]
    promised = {one.family.terms[-1]: problem.held_out_squares(one).mean() for one in ahead}
    for seen in sorted(ahead, key=lambda one: promised[one.family.terms[-1]]):
        term = seen.family.terms[-1]
        by_speed = term == "growth" and problem.speeds_apart >= SPEEDS_APART
        if not by_speed and promised[term] > (1 - LEAST_GAIN) * now.mean():
            lines.append(f"{term} stays out: a step promises held-out NRMSE {np.sqrt(promised[term]):.2%}")
            continue
        tried = problem.solve(seen.family, seen.step(np.ones(len(problem.curves))))
        of, squares = ("NRMSE", problem.held_out_squares)
        if by_speed:
            of, squares = ("error of the tangents per speed", problem.held_out_tangent_squares)
        before, after = squares(found), squares(tried)
        gain = before - after
        enters = gain.mean() > max(float(gain.std(ddof=1)) / np.sqrt(len(gain)), LEAST_GAIN * before.mean())
        lines.append(
            f"{term} {'enters' if enters else 'stays out'}: held-out {of} {_root(before):.2%} -> {_root(after):.2%}"
        )
        problem.on_progress(lines[-1])
        if enters:
            return tried
    return None


def _root(squares: Array) -> float:
    """Return the root of a mean, which rounding may put a little below zero."""
    return float(np.sqrt(max(squares.mean(), 0.0)))


def _draws(problem: Problem, found: Solution) -> Array | None:
    """Return the parameters (BOOTSTRAPS, n) for trials resampled with replacement, each by one Gauss-Newton step."""
    count = len(problem.curves)
    if count == 1:
        return None
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    weights = rng.multinomial(count, np.full(count, 1 / count), BOOTSTRAPS).astype(float)
    return np.array([found.resampled(weight) for weight in weights])


def _half_width(logs: Array) -> float:
    """Return half the width of a parameter's interval as a share of its value, from logarithms of its draws."""
    low, high = np.percentile(logs, [2.5, 97.5])
    return float(np.expm1((high - low) / 2))
