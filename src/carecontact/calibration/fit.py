"""Fits the anchor law to replayed trials: bounded least squares, intervals from resampled trials, errors on held-out
trials.

scipy's least_squares rather than mujoco.sysid: sysid fits recorded control and sensor sequences of equal time stamps
and needs packages of its own; here the residual is force over depth past a touch that both sides find by force, the
rollout is a prescribed motion, and the Jacobian is wanted afterwards for the intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from carecontact.calibration.agreement import Agreement, agreement
from carecontact.calibration.curve import Curve
from carecontact.calibration.replay import Group, Replay, Replayed, on_trial
from carecontact.calibration.trial import Array
from carecontact.contract.protocol import Tissue

LAW = ("a_n_m3", "b_n_m4", "c_n_m5")
DAMPING = "damping_ns_m3"
DIFF_STEP = 0.03
"""Step of the finite differences in every parameter; parameters are logarithms, and shares of the pressure at the
typical depth."""
BOOTSTRAPS = 2000
BOOTSTRAP_SEED = 20250101
FOLDS = 5
MIN_LOOP = 0.5
"""Damping counts as identified if half the width of its interval is below this share of its value."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    tissue: Tissue
    damping_identified: bool
    damping_reason: str
    replayed: list[Replayed]
    agreement: list[Agreement]
    """One per trial, in their order, under the law that was fitted to all trials."""
    held_out: list[Agreement] | None
    """One per trial, simulated under a law that was fitted without the trial's fold; None for a single trial."""
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
    """Fit (a, b, c) and, where trials unload, D_c.

    b and c are kept at or above zero (tissue stiffens); a and D_c are fitted as logarithms. Where no trial unloads, or
    the trials do not pin D_c down, D_c keeps its ratio to a, and the reason is given.
    """
    unloads = any(curve.trial.unloads for curve in curves)
    problem = _Problem(curves, replay, damping=unloads)
    reason = "fitted" if unloads else "no trial unloads"
    p = problem.solve(problem.start(), on_progress)
    draws = problem.draws(p) if len(curves) > 1 else None
    if unloads and draws is None:
        reason = "fitted to a single trial, which gives it no interval"
    if unloads and draws is not None:
        low, high = np.percentile(draws[:, -1], [2.5, 97.5])
        half = float(np.expm1((high - low) / 2))
        if half > MIN_LOOP:
            unloads, reason = (
                False,
                f"its interval is +-{half:.0%}: the loops between loading and unloading are too thin",
            )
            problem = _Problem(curves, replay, damping=False)
            p = problem.solve(problem.start(), on_progress)
            draws = problem.draws(p)
    residual, jacobian = problem.residual, problem.jacobian
    replay.forget()
    final = problem.at(p)
    rows = agreements(curves, replay.groups, final)
    held = None
    if len(curves) > 1:
        on_progress(f"held-out trials in {min(FOLDS, len(curves))} folds")
        held = problem.held_out(p, residual, jacobian)
    return Fit(
        tissue=problem.tissue(p),
        damping_identified=unloads,
        damping_reason=reason,
        replayed=[one for one in final if one is not None],
        agreement=rows,
        held_out=held,
        draws=None if draws is None else [problem.tissue(q) for q in draws],
        secant_draws=None if draws is None else problem.stiffness_change(p, draws),
        evaluations=problem.evaluations,
    )


class _Problem:
    """Parameters: log of a's pressure at the typical depth, b's and c's as shares of the starting one, log of D."""

    def __init__(self, curves: Sequence[Curve], replay: Replay, *, damping: bool) -> None:
        self.curves, self.replay, self.damping = curves, replay, damping
        self.base = replay.tissue
        self.depth = float(np.median([curve.deepest_m for curve in curves]))
        self.unit = _pressure(self.base, self.depth)
        self.ratio = self.base.damping_ns_m3 * self.depth / self.unit
        self.owner = {k: number for number, group in enumerate(replay.groups) for k in group.members}
        self.rows: list[slice] = []
        self.evaluations = 0
        self.residual, self.jacobian = np.zeros(0), np.zeros((0, 0))
        self.last, self.last_at = np.zeros(0), np.zeros(0)

    def tissue(self, p: Array) -> Tissue:
        a = float(np.exp(p[0])) * self.unit / self.depth
        b, c = (float(p[k]) * self.unit / self.depth ** (k + 1) for k in (1, 2))
        total = a * self.depth + b * self.depth**2 + c * self.depth**3
        damping = float(np.exp(p[3])) if self.damping else self.ratio * total / self.depth
        return self.base.model_copy(update={"a_n_m3": a, "b_n_m4": b, "c_n_m5": c, "damping_ns_m3": damping})

    def start(self) -> Array:
        """The base law, scaled so that its forces are the measured ones on average."""
        scale = 1.0
        for _ in range(2):
            law = {name: scale * getattr(self.base, name) for name in (*LAW, DAMPING)}
            replayed = self.replay.run(self.base.model_copy(update=law))
            pairs = [
                (np.nansum(on_trial(one, g, self.curves[k])[0] * self.curves[k].loading_n),
                 np.nansum(on_trial(one, g, self.curves[k])[0] ** 2))
                for g, one in zip(self.replay.groups, replayed, strict=True) if one is not None for k in g.members
            ]  # fmt: skip
            scale *= float(np.median([mixed / own for mixed, own in pairs]))
        self.evaluations += 2
        share = [getattr(self.base, name) * self.depth ** (k + 1) / self.unit for k, name in enumerate(LAW)]
        p = np.array([np.log(max(scale * share[0], 0.02)), max(scale * share[1], 0.05), max(scale * share[2], 0.05)])
        if not self.damping:
            return p
        return np.r_[p, np.log(scale * self.base.damping_ns_m3)]

    def at(self, p: Array, only: Sequence[int] | None = None) -> list[Replayed | None]:
        self.evaluations += 1
        return self.replay.run(self.tissue(p), only)

    def residuals(self, p: Array) -> Array:
        """Differences divided by the measured peak; every trial weighs the same. Rows are in the order of the
        trials."""
        replayed = self.at(p)
        parts = []
        for index, curve in enumerate(self.curves):
            number = self.owner[index]
            one = replayed[number]
            assert one is not None
            load, back = on_trial(one, self.replay.groups[number], curve)
            part = np.r_[load - curve.loading_n, back - curve.unloading_n] / curve.peak_n
            fine = np.isfinite(part)
            parts.append(part[fine] / np.sqrt(fine.sum()))
        stops = np.cumsum([0, *map(len, parts)])
        self.rows = [slice(int(a), int(b)) for a, b in pairwise(stops)]
        return np.concatenate(parts)

    def solve(self, start: Array, on_progress: Callable[[str], None]) -> Array:
        from scipy.optimize import least_squares

        def told(p: Array) -> Array:
            residual = self.residuals(p)
            self.last, self.last_at = residual, p.copy()
            on_progress(f"evaluation {self.evaluations}: NRMSE {np.sqrt(np.mean(self._squares(residual))):.2%}")
            return residual

        low = [np.log(1e-3), 0.0, 0.0, np.log(1.0)][: len(start)]
        high = [np.log(1e3), 1e3, 1e3, np.log(1e9)][: len(start)]
        found = least_squares(
            told, np.clip(start, low, high), jac=self.differences,  # pyright: ignore[reportArgumentType]
            bounds=(low, high), x_scale=[0.3, 0.3, 0.3, 1.5][: len(start)],
            ftol=1e-3, xtol=1e-3, max_nfev=20, method="dogbox",
        )  # fmt: skip
        self.residual, self.jacobian = found.fun, found.jac
        return found.x

    def differences(self, p: Array) -> Array:
        """Forward differences of the residuals at the last evaluated point."""
        base = self.last if np.array_equal(p, self.last_at) else self.residuals(p)
        return np.stack([(self.residuals(p + DIFF_STEP * unit) - base) / DIFF_STEP for unit in np.eye(len(p))], 1)

    def _squares(self, residual: Array) -> Array:
        return np.array([np.sum(residual[rows] ** 2) for rows in self.rows])

    def step(self, p: Array, weight: Array) -> Array:
        """One Gauss-Newton step from the optimum with each trial weighted; b and c stay at or above zero."""
        normal = np.zeros((len(p), len(p)))
        gradient = np.zeros(len(p))
        for w, rows in zip(weight, self.rows, strict=True):
            j = self.jacobian[rows]
            normal += w * j.T @ j
            gradient += w * j.T @ self.residual[rows]
        return _step_within(p, normal, gradient)

    def draws(self, p: Array) -> Array:
        """(BOOTSTRAPS, n) parameters of trials resampled with replacement, each by one Gauss-Newton step."""
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        count = len(self.curves)
        weights = rng.multinomial(count, np.full(count, 1 / count), BOOTSTRAPS).astype(float)
        # The optimum is found to a tolerance; the rest of the way to it is not part of the spread.
        rest = self.step(p, np.ones(count)) - p
        return np.array([moved_back(self.step(p, weight), rest) for weight in weights])

    def held_out(self, p: Array, residual: Array, jacobian: Array) -> list[Agreement]:
        """Every trial once: the law comes from the other folds (one Gauss-Newton step), the press is simulated anew."""
        folds = np.zeros(len(self.curves), int)
        order = [k for group in self.replay.groups for k in group.members]
        folds[order] = np.arange(len(order)) % min(FOLDS, len(order))
        out: dict[int, Agreement] = {}
        # As in draws: what is left of the way to the optimum belongs to no fold.
        rest = self.step(p, np.ones(len(self.curves))) - p
        for fold in np.unique(folds):
            gone = [int(k) for k in np.flatnonzero(folds == fold)]
            law = moved_back(self.step(p, (folds != fold).astype(float)), rest)
            replayed = self.at(law, only=sorted({self.owner[k] for k in gone}))
            rows = agreements(self.curves, self.replay.groups, replayed)
            out |= {k: rows[n] for n, k in enumerate(self._seen(replayed)) if k in gone}
        return [out[k] for k in range(len(self.curves))]

    def _seen(self, replayed: list[Replayed | None]) -> list[int]:
        return [k for k in range(len(self.curves)) if replayed[self.owner[k]] is not None]

    def stiffness_change(self, p: Array, draws: Array) -> Array:
        """(draws, 2) linearised relative change of the mean simulated secant and tangent stiffness."""
        secant, slope = [], []
        for curve, rows in zip(self.curves, self.rows, strict=True):
            j = self.jacobian[rows] * np.sqrt(rows.stop - rows.start)
            last = int(np.isfinite(curve.loading_n).sum()) - 1
            last = min(last, len(j) - 1)
            secant.append(j[last])
            slope.append((j[last] - j[last // 2]) * 2)
        delta = draws - p
        return np.stack([delta @ np.mean(secant, 0), delta @ np.mean(slope, 0)], 1)


def _step_within(p: Array, normal: Array, gradient: Array) -> Array:
    free: npt.NDArray[np.bool_] = np.ones(len(p), bool)
    for k in (1, 2):
        # At its bound and pulled further: it stays there.
        free[k] = not (p[k] < 1e-6 and gradient[k] > 0)
    for _ in range(3):
        out = p.copy()
        system = normal[np.ix_(free, free)]
        ridge = 1e-9 * np.trace(system) / len(system) * np.eye(len(system))
        out[free] -= np.linalg.solve(system + ridge, gradient[free])
        below = [k for k in (1, 2) if free[k] and out[k] < 0]
        if not below:
            break
        # With one share held at zero the others move to make up for it.
        free[below] = False
        gradient = gradient + normal[:, below] @ (-p[below])
        p = p.copy()
        p[below] = 0.0
    return out


def moved_back(stepped: Array, rest: Array) -> Array:
    """``stepped`` less ``rest``; b and c that a step held at zero stay there, and none falls below."""
    out = stepped - rest
    out[1:3] = np.where(stepped[1:3] <= 0, 0.0, np.maximum(out[1:3], 0.0))
    return out


def agreements(
    curves: Sequence[Curve], groups: Sequence[Group], replayed: Sequence[Replayed | None]
) -> list[Agreement]:
    """In the order of the trials, without those whose group was not replayed."""
    out: dict[int, Agreement] = {}
    for group, one in zip(groups, replayed, strict=True):
        if one is None:
            continue
        for k in group.members:
            curve = curves[k]
            out[k] = agreement(curve.grid_m, (curve.loading_n, curve.unloading_n), on_trial(one, group, curve))
    return [out[k] for k in sorted(out)]


def _pressure(tissue: Tissue, depth: float) -> float:
    return tissue.a_n_m3 * depth + tissue.b_n_m4 * depth**2 + tissue.c_n_m5 * depth**3
