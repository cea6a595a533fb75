"""The least-squares problem of a calibration: the laws, how a simulated press agrees with a measured one, and the
residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from carecontact.lab.calibration.curve import Curve
from carecontact.lab.calibration.replay import REACH, Group, Replay, Replayed, on_trial
from carecontact.lab.calibration.trial import Array
from carecontact.protocol.person import LARGEST_CONTACT, Tissue

TERMS = ("bend", "rise", "growth")
ROUND = 0.9
"""The tangent of a bent law never falls below its value at first touch times 1 minus this share."""
_BOUNDS = {
    "level": (np.log(1e-3), np.log(1e3), 0.3),
    "damping": (np.log(1.0), np.log(1e9), 1.0),
    "bend": (-4.0, 3.0, 0.3),
    "rise": (0.0, 5.0, 0.5),
    "growth": (0.0, 0.95, 0.5),
}
"""Parameter -> least value, largest value, and scale."""
STEP = {"level": 0.03, "damping": 0.1, "bend": 0.05, "rise": 0.1, "growth": 0.1}
"""Steps of the parameters for finite differences."""


@dataclass(frozen=True, kw_only=True)
class Family:
    """Laws with the same terms, on one mesh.

    Every law has a level, the anchor's pressure at the typical depth. If damping is fitted, it also has the damping at
    half of that depth. A *term* adds one parameter to it:

    - ``bend`` k: the tangent a + 2 b x + 3 c x^2 follows (1 - k x / depth)^2, ``ROUND`` of it, so that it never reaches
      zero. Where k is above zero, b is below it. Where it is below zero, b is a (exp(-k) - 1) ``ROUND`` / depth, and c
      is 0;
    - ``rise`` q: the tangent grows by a (exp(q) - 1) times the square of the depth, which is c;
    - ``growth``: the share of the damping at half depth that grows with indentation, as in Hunt and Crossley's contact.

    Every choice of parameters within the bounds is a convex law, so that a fit never meets one that ``Tissue`` refuses.
    """

    base: Tissue
    """Gives all fields besides the law and, if damping is not fitted, the ratio of damping to stiffness."""
    depth_m: float
    """Typical depth of the trials."""
    damping: bool
    """Whether damping is fitted."""
    terms: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return ("level", *(("damping",) if self.damping else ()), *self.terms)

    @property
    def low(self) -> Array:
        return np.array([_BOUNDS[name][0] for name in self.names])

    @property
    def high(self) -> Array:
        return np.array([_BOUNDS[name][1] for name in self.names])

    @property
    def scale(self) -> Array:
        return np.array([_BOUNDS[name][2] for name in self.names])

    @property
    def candidates(self) -> tuple[str, ...]:
        return tuple(t for t in TERMS if t not in self.terms and (t != "growth" or self.damping))

    def plus(self, term: str) -> Family:
        """Return the family with one more term, whose parameter comes last; at 0, the law is the one without it."""
        return replace(self, terms=(*self.terms, term))

    def tissue(self, p: Array) -> Tissue:
        """Return the tissue with the law (a, b, c, damping and its growth) of parameters in the order of ``names``."""
        of = dict(zip(self.names, map(float, p), strict=True))
        level = np.exp(of["level"]) * _pressure(self.base, self.depth_m)
        bend = of.get("bend", 0.0)
        slope = ROUND * (bend if bend > 0 else -np.expm1(-bend))
        square = ROUND * max(bend, 0.0) ** 2 + np.expm1(of.get("rise", 0.0))
        # ``Tissue`` refuses anchors that are much softer than the contact layer.
        softest = 1.01 * self.base.contact_n_m3 / LARGEST_CONTACT
        a = max(level / self.depth_m / (1 - slope + square / 3), softest)
        if self.damping:
            half, growth = np.exp(of["damping"]), of.get("growth", 0.0)
            damping, grows = half * (1 - growth), 2 * half * growth / self.depth_m
        else:
            ratio = level / _pressure(self.base, self.depth_m)
            damping, grows = ratio * self.base.damping_ns_m3, ratio * self.base.damping_growth_ns_m4
        law = {"a_n_m3": a, "b_n_m4": -a * slope / self.depth_m, "c_n_m5": a * square / 3 / self.depth_m**2}
        law |= {"damping_ns_m3": damping, "damping_growth_ns_m4": grows}
        return self.base.model_copy(update={name: float(value) + 0.0 for name, value in law.items()})

    def start(self, scale: float) -> Array:
        """Return the parameters of the base law, made ``scale`` times as stiff, without any term."""
        half = self.base.damping_ns_m3 + self.base.damping_growth_ns_m4 * self.depth_m / 2
        return np.array([np.log(scale), np.log(scale * half)][: len(self.names)])


def _pressure(tissue: Tissue, depth: float) -> float:
    return tissue.a_n_m3 * depth + tissue.b_n_m4 * depth**2 + tissue.c_n_m5 * depth**3


UPPER = 0.5
"""Tangent stiffness is the slope over the depths from this share of the deepest point on."""
LEAST_LOSS = 0.01
"""A measured loop that loses less than this share of the work of the loading counts as losing so much: the error of
lost work is relative to it, and friction makes every simulated loop lose some."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    nrmse: float
    """Root mean square of the difference over loading and unloading, divided by the measured peak."""
    r2: float
    """Share of the measured force's variance that the simulation explains."""
    peak_error: float
    """Simulated divided by measured force at the deepest common point, minus 1."""
    tangent_error: float
    """Relative error of the slope over the deeper half of the loading."""
    work_j: tuple[float, float] | None
    """Work that the measured and the simulated loop enclose [J]; None without unloading."""


POOLED = ("nrmse", "r2", "peak_error", "tangent_error", "work_error")
"""What is pooled over trials; ``work_error`` is that of the work that all trials lose together."""


def agreement(depth: Array, measured: tuple[Array, Array], simulated: tuple[Array, Array]) -> Agreement:
    """Compare loading and unloading forces (n,) [N], nan where there are none, at depths (n,) [m]."""
    both = np.isfinite(measured[0]) & np.isfinite(simulated[0])
    d, m, s = depth[both], measured[0][both], simulated[0][both]
    back = np.isfinite(measured[1]) & np.isfinite(simulated[1])
    measured_all = np.r_[m, measured[1][back]]
    simulated_all = np.r_[s, simulated[1][back]]
    difference = simulated_all - measured_all
    return Agreement(
        nrmse=float(np.sqrt(np.mean(difference**2)) / m[-1]),
        r2=float(1 - np.sum(difference**2) / np.sum((measured_all - measured_all.mean()) ** 2)),
        peak_error=float(s[-1] / m[-1] - 1),
        tangent_error=tangent(d, s) / tangent(d, m) - 1,
        work_j=lost_work(depth, measured, simulated),
    )


def tangent(depth: Array, force: Array) -> float:
    """Return the slope of the force over the deeper half of the depths [N/m]."""
    upper = depth >= UPPER * depth[-1]
    return float(np.polyfit(depth[upper], force[upper], 1)[0])


def lost_work(
    depth: Array, measured: tuple[Array, Array], simulated: tuple[Array, Array]
) -> tuple[float, float] | None:
    """Return the work [J], at least LEAST_LOSS, that both loops enclose at depths where both have both ways; None if
    these are too few."""
    loops = measured[0] - measured[1], simulated[0] - simulated[1]
    both = np.isfinite(loops[0]) & np.isfinite(loops[1])
    if both.sum() <= 3:
        return None
    lost = [float(np.trapezoid(loop[both], depth[both])) for loop in loops]
    return max(lost[0], LEAST_LOSS * float(np.trapezoid(measured[0][both], depth[both]))), lost[1]


def work_error(lost: list[tuple[float, float] | None]) -> float | None:
    """Return the relative error of the work that all trials lose together; None if they lose none."""
    measured, simulated = np.sum([one for one in lost if one is not None] or [(0.0, 0.0)], axis=0)
    return float(simulated / measured - 1) if measured > 0 else None


def pooled(rows: Sequence[Agreement]) -> dict[str, float | None]:
    """Pool the agreement of trials: the root mean square of ``nrmse``, the error of all lost work, the means of all
    other values."""
    values = {name: np.array([getattr(row, name) for row in rows]) for name in POOLED[:-1]}
    means: dict[str, float | None] = {name: float(one.mean()) for name, one in values.items()}
    nrmse = float(np.sqrt(np.mean(values["nrmse"] ** 2)))
    return {**means, "nrmse": nrmse, "work_error": work_error([one.work_j for one in rows])}


FOLDS = 5
LEVELLINGS = 2
"""Number of Newton steps for the parameters of ``levelled``, in which forces are almost linear."""
EVALUATIONS = 12
"""Most points that the solver tries; each needs finite differences of its own."""


@dataclass(frozen=True, kw_only=True)
class Solution:
    family: Family
    p: Array
    residual: Array
    jacobian: Array
    rows: tuple[slice, ...]
    """Rows of the residual that belong to each trial, in their order."""

    def step(self, weight: Array) -> Array:
        """One Gauss-Newton step from the optimum with each trial weighted, within the bounds."""
        n = len(self.p)
        normal, gradient = np.zeros((n, n)), np.zeros(n)
        for w, rows in zip(weight, self.rows, strict=True):
            j = self.jacobian[rows]
            normal += w * j.T @ j
            gradient += w * j.T @ self.residual[rows]
        return step_within(self.p, normal, gradient, self.family.low, self.family.high)

    def resampled(self, weight: Array) -> Array:
        """Return ``step`` minus the step of all trials with equal weight: the optimum is known only to a tolerance, and
        the remaining step to it is no effect of the resampling."""
        rest = self.step(np.ones(len(self.rows))) - self.p
        return moved_back(self.step(weight), rest, self.family.low, self.family.high)

    def squares(self, p: Array | None = None) -> Array:
        """Return the sum of each trial's squared residuals at the optimum or, by the Jacobian, at ``p``."""
        residual = self.residual if p is None else self.residual + self.jacobian @ (p - self.p)
        return np.array([np.sum(residual[rows] ** 2) for rows in self.rows])


class Problem:
    def __init__(self, curves: Sequence[Curve], replay: Replay, on_progress: Callable[[str], None]) -> None:
        self.curves, self.replay, self.on_progress = curves, replay, on_progress
        self.base = replay.tissue
        self.depth = float(np.median([curve.deepest_m for curve in curves]))
        self.owner = {k: number for number, group in enumerate(replay.groups) for k in group.members}
        self.evaluations = 0

    def at(self, tissue: Tissue, only: Sequence[int] | None = None) -> list[Replayed | None]:
        self.evaluations += 1
        return self.replay.run(tissue, only)

    def start(self, family: Family) -> Array:
        """Return the base law, scaled so that its forces equal the measured ones on average."""
        scale = 1.0
        for _ in range(2):
            replayed = self.at(family.tissue(family.start(scale)))
            ratios = []
            for curve, (load, _) in zip(self.curves, self._legs(replayed), strict=True):
                ratios.append(np.nansum(load * curve.loading_n) / np.nansum(load**2))
            scale *= float(np.median(ratios))
        return family.start(scale)

    def _legs(self, replayed: Sequence[Replayed | None]) -> list[tuple[Array, Array]]:
        """Return the simulated loading and unloading forces of every trial, all of which were replayed."""
        groups = self.replay.groups
        return [
            on_trial(one, groups[n], self.curves[k])
            for k, n in sorted(self.owner.items())
            if (one := replayed[n]) is not None
        ]

    def residuals(self, tissue: Tissue) -> tuple[Array, tuple[slice, ...]]:
        """Return the differences of force divided by the measured peak, and the rows of each trial; all trials weigh
        the same."""
        return self._differences(self._legs(self.at(tissue)))

    def _differences(self, legs: Sequence[tuple[Array, Array]]) -> tuple[Array, tuple[slice, ...]]:
        parts = []
        for curve, (load, back) in zip(self.curves, legs, strict=True):
            part = np.r_[load - curve.loading_n, back - curve.unloading_n] / curve.peak_n
            fine = np.isfinite(part)
            parts.append(part[fine] / np.sqrt(fine.sum()))
        stops = np.cumsum([0, *map(len, parts)])
        return np.concatenate(parts), tuple(slice(int(a), int(b)) for a, b in pairwise(stops))

    def solve(self, family: Family, start: Array) -> Solution:
        from scipy.optimize import least_squares

        rows: tuple[slice, ...] = ()
        last, last_at = np.zeros(0), np.zeros(0)

        def residual(p: Array) -> Array:
            nonlocal rows, last, last_at
            last, rows = self.residuals(family.tissue(p))
            last_at = p.copy()
            self.on_progress(f"evaluation {self.evaluations}: NRMSE {np.sqrt(last @ last / len(rows)):.2%}")
            return last

        def jacobian(p: Array) -> Array:
            return self.jacobian(family, p, last if np.array_equal(p, last_at) else residual(p))

        bounds = (family.low, family.high)
        tolerances = {"ftol": 3e-3, "xtol": 2e-3, "max_nfev": EVALUATIONS}
        found = least_squares(
            residual, np.clip(start, *bounds), jac=jacobian,  # pyright: ignore[reportArgumentType]
            bounds=bounds, x_scale=family.scale, method="dogbox",
            **tolerances,
        )  # fmt: skip
        return Solution(family=family, p=found.x, residual=found.fun, jacobian=found.jac, rows=rows)

    def levelled(self, found: Solution) -> Solution:
        """Return the same law, scaled so that forces and stiffness err least together, with the damping that loses as
        much work as was measured.

        Least is the sum, over all trials, of the squares of the NRMSE and of both errors of ``stiffness_errors``.
        Forces alone decide the law's shape. If no law of the family follows them at every depth, it is too soft at
        first and too stiff later; the right stiffness then matters more than the right force halfway.

        The work is that of all trials together: friction between indenter and skin loses the same at every speed, and
        the damping, which does not, makes up for it where trials lose less in slow presses.
        """
        family, p = found.family, found.p.copy()
        names = [name for name in ("level", "damping") if name in family.names]
        for _ in range(LEVELLINGS):
            errors, work = self.errors(family.tissue(p))
            slopes, works = [], []
            for name in names:
                ahead = p.copy()
                ahead[family.names.index(name)] += STEP[name]
                errors_ahead, work_ahead = self.errors(family.tissue(ahead))
                slopes.append((errors_ahead - errors) / STEP[name])
                works.append((work_ahead - work) / STEP[name])
            step = -slopes[0] @ errors / (slopes[0] @ slopes[0])
            p[family.names.index("level")] += step
            if "damping" in names and works[1] > 0:
                p[family.names.index("damping")] -= (work + works[0] * step) / works[1]
            p = np.clip(p, family.low, family.high)
        residual, rows = self.residuals(family.tissue(p))
        return Solution(family=family, p=p, residual=residual, jacobian=self.jacobian(family, p, residual), rows=rows)

    def errors(self, tissue: Tissue) -> tuple[Array, float]:
        """Return the residuals together with both errors of stiffness of every trial, and the relative error of the
        work that all trials lose."""
        legs = self._legs(self.at(tissue))
        pairs = list(zip(self.curves, legs, strict=True))
        stiffness = [stiffness_errors(curve, *both) for curve, both in pairs]
        lost = [lost_work(curve.grid_m, (curve.loading_n, curve.unloading_n), both) for curve, both in pairs]
        return np.r_[self._differences(legs)[0], np.ravel(stiffness)], work_error(lost) or 0.0

    def jacobian(self, family: Family, p: Array, residual: Array) -> Array:
        return np.stack([self.difference(family, p, residual, k) for k in range(len(p))], 1)

    def difference(self, family: Family, p: Array, residual: Array, column: int) -> Array:
        """Return one column of the Jacobian, by a finite difference that stays within the bounds."""
        by, step = np.zeros(len(p)), STEP[family.names[column]]
        by[column] = -step if p[column] + step > family.high[column] else step
        return (self.residuals(family.tissue(p + by))[0] - residual) / by[column]

    def with_term(self, found: Solution, term: str) -> Solution:
        """Return the same law in the family with one more term, whose parameter is 0, which is not its optimum."""
        family, p = found.family.plus(term), np.r_[found.p, 0.0]
        column = self.difference(family, p, found.residual, len(found.p))
        return replace(found, family=family, p=p, jacobian=np.c_[found.jacobian, column])

    def folds(self) -> Array:
        """Return the number of each trial's fold (trials,); trials that share a replay are spread over the folds."""
        out = np.zeros(len(self.curves), int)
        order = [k for group in self.replay.groups for k in group.members]
        out[order] = np.arange(len(order)) % min(FOLDS, len(order))
        return out

    def held_out_squares(self, found: Solution) -> Array:
        """Return the squared error (trials,) of each trial under the law of the other folds, one Gauss-Newton step
        away; the Jacobian gives it without another simulation."""
        folds, out = self.folds(), np.zeros(len(self.curves))
        for fold in np.unique(folds):
            gone = folds == fold
            out[gone] = found.squares(found.step((~gone).astype(float)))[gone]
        return out

    @property
    def speeds_apart(self) -> float:
        speeds = [curve.trial.condition.speed_m_s for curve in self.curves]
        return max(speeds) / min(speeds)

    def held_out_tangent_squares(self, found: Solution) -> Array:
        """Return the error of each trial's tangent while loading, times the mean error at its speed (trials,), each
        trial under the law of the other folds. Their mean is the mean square of the errors of the speeds.

        The Jacobian gives them without another simulation, because a tangent is linear in the forces.
        """
        folds, errors = self.folds(), np.zeros(len(self.curves))
        for k, curve in enumerate(self.curves):
            rows = found.rows[k]
            p = found.step((folds != folds[k]).astype(float))
            residual = found.residual[rows] + found.jacobian[rows] @ (p - found.p)
            loading = curve.grid_m <= self.replay.groups[self.owner[k]].deepest_m * REACH
            difference = residual[: loading.sum()] * np.sqrt(len(residual)) * curve.peak_n
            depth = curve.grid_m[loading]
            errors[k] = tangent(depth, difference) / tangent(depth, curve.loading_n[loading])
        speeds = np.array([curve.trial.condition.speed_m_s for curve in self.curves])
        return errors * [errors[speeds == speed].mean() for speed in speeds]

    def held_out(self, found: Solution) -> list[Agreement]:
        """Return the agreement of every trial with the law of the other folds, one Gauss-Newton step away; each press
        is simulated again."""
        folds = self.folds()
        out: dict[int, Agreement] = {}
        for fold in np.unique(folds):
            gone = set(np.flatnonzero(folds == fold).tolist())
            law = found.family.tissue(found.resampled((folds != fold).astype(float)))
            replayed = self.at(law, only=sorted({self.owner[k] for k in gone}))
            seen = [k for k in range(len(self.curves)) if replayed[self.owner[k]] is not None]
            rows = zip(seen, agreements(self.curves, self.replay.groups, replayed), strict=True)
            out |= {k: row for k, row in rows if k in gone}
        return [out[k] for k in range(len(self.curves))]

    def stiffness_change(self, found: Solution, draws: Array) -> Array:
        """Return the relative change (draws, 2) of the mean simulated secant and tangent stiffness, linearised."""
        secant, slope = [], []
        for curve, rows in zip(self.curves, found.rows, strict=True):
            j = found.jacobian[rows] * np.sqrt(rows.stop - rows.start)
            last = min(int(np.isfinite(curve.loading_n).sum()), len(j)) - 1
            secant.append(j[last])
            slope.append((j[last] - j[last // 2]) * 2)
        delta = draws - found.p
        return np.stack([delta @ np.mean(secant, 0), delta @ np.mean(slope, 0)], 1)


def stiffness_errors(curve: Curve, load: Array, back: Array) -> Array:
    """Return the relative errors (2,) of the simulated secant stiffness and of the tangent over the deeper half.

    If a trial unloads, they are computed from the mean of loading and unloading, in which losses cancel, so that
    damping cannot compensate for stiffness. The error of the tangent is relative to the tangent or the secant,
    whichever is larger, because the error relative to a tangent near zero has no meaning.
    """
    measured, simulated = curve.loading_n, load
    if curve.trial.unloads:
        measured, simulated = (curve.loading_n + curve.unloading_n) / 2, (load + back) / 2
    both = np.isfinite(measured) & np.isfinite(simulated)
    depth, measured, simulated = curve.grid_m[both], measured[both], simulated[both]
    slope, secant = tangent(depth, measured), measured[-1] / depth[-1]
    return np.array([simulated[-1] / measured[-1] - 1, (tangent(depth, simulated) - slope) / max(slope, secant)])


def step_within(p: Array, normal: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Return the parameters after one Newton step; a parameter that would leave its bounds stops there, and the others
    are solved for again."""
    out, free = p.copy(), np.ones(len(p), bool)
    for _ in range(len(p)):
        fixed = out - p
        fixed[free] = 0.0
        system = normal[np.ix_(free, free)]
        ridge = 1e-9 * np.trace(system) / len(system) * np.eye(len(system))
        out[free] = p[free] - np.linalg.solve(system + ridge, (gradient + normal @ fixed)[free])
        outside = free & ((out < low) | (out > high))
        if not outside.any():
            break
        out = np.clip(out, low, high)
        free &= ~outside
        if not free.any():
            break
    return np.clip(out, low, high)


def moved_back(stepped: Array, rest: Array, low: Array, high: Array) -> Array:
    """Return ``stepped`` minus ``rest`` within the bounds; a parameter that the step stopped at a bound stays there."""
    held: npt.NDArray[np.bool_] = (stepped <= low) | (stepped >= high)
    return np.where(held, stepped, np.clip(stepped - rest, low, high))


def agreements(
    curves: Sequence[Curve], groups: Sequence[Group], replayed: Sequence[Replayed | None]
) -> list[Agreement]:
    """Return the agreement of the trials, in their order, without those whose group was not replayed."""
    out: dict[int, Agreement] = {}
    for group, one in zip(groups, replayed, strict=True):
        if one is None:
            continue
        for k in group.members:
            curve = curves[k]
            out[k] = agreement(curve.grid_m, (curve.loading_n, curve.unloading_n), on_trial(one, group, curve))
    return [out[k] for k in sorted(out)]
