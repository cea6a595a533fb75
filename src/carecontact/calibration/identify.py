"""Finds the simple law that describes the measured response best: four candidates, AICc and leave-one-trial-out
errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from carecontact.calibration.curve import Curve
from carecontact.calibration.trial import Array

MAX_FOLDS = 20
"""Up to this number, trials are left out one by one; more trials are left out in this number of groups."""


@dataclass(frozen=True, kw_only=True)
class Law:
    """Force over depth and speed, both scaled to the trials (u = 1 at the median deepest point, f = 1 at its force)."""

    name: str
    formula: str
    names: tuple[str, ...]
    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    force: Callable[[Array, Array, Array], Array]


def _hunt_crossley(p: Array, u: Array, v: Array) -> Array:
    return p[0] * u ** p[1] * (1 + p[2] * v)


LAWS = (
    Law(name="linear", formula="k d", names=("k",), start=(1.0,), low=(0.0,), high=(10.0,),
        force=lambda p, u, v: p[0] * u),
    Law(name="quadratic", formula="k1 d + k2 d^2", names=("k1", "k2"), start=(0.5, 0.5), low=(0.0, -5.0),
        high=(10.0, 10.0), force=lambda p, u, v: p[0] * u + p[1] * u**2),
    Law(name="exponential", formula="A (exp(d / delta) - 1)", names=("A", "delta"), start=(0.5, 1.0), low=(1e-4, 0.1),
        high=(100.0, 100.0), force=lambda p, u, v: p[0] * np.expm1(u / p[1])),
    Law(name="hunt-crossley", formula="k d^n (1 + beta v)", names=("k", "n", "beta"), start=(1.0, 1.3, 0.0),
        low=(0.0, 0.5, 0.0), high=(10.0, 4.0, 100.0), force=_hunt_crossley),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Identified:
    law: Law
    parameters: Array
    """Parameters in scaled units, followed by the depth at touch as a share of depth_scale_m, because the force at
    touch is not zero."""
    depth_scale_m: float
    force_scale_n: float
    speed_scale_m_s: float
    rms: float
    """Root mean square of the residuals, each divided by its trial's peak force."""
    aicc: float
    left_out_rms: float | None
    """The same for trials left out of the fit; None for a single trial."""

    def force_n(self, depth_m: Array, speed_m_s: Array | float) -> Array:
        """Return the force [N] at depths past touch [m]; the speed [m/s] is negative while unloading."""
        u = depth_m / self.depth_scale_m + self.parameters[-1]
        v = speed_m_s / self.speed_scale_m_s + np.zeros_like(u)
        return self.force_scale_n * self.law.force(self.parameters[:-1], u, v)

    def physical(self) -> dict[str, float]:
        """Return the parameters in N, mm and s, by names that contain the unit."""
        d, f, v = 1000 * self.depth_scale_m, self.force_scale_n, 1000 * self.speed_scale_m_s
        p = self.parameters
        match self.law.name:
            case "linear":
                out = {"k_N_mm": f * p[0] / d}
            case "quadratic":
                out = {"k1_N_mm": f * p[0] / d, "k2_N_mm2": f * p[1] / d**2}
            case "exponential":
                out = {"A_N": f * p[0], "delta_mm": d * p[1]}
            case _:
                out = {"k_N_mm^n": f * p[0] / d ** p[1], "n": p[1], "beta_s_mm": p[2] / v}
        return {name: float(value) for name, value in out.items()} | {"depth_at_touch_mm": float(d * p[-1])}


def identify(curves: Sequence[Curve]) -> tuple[Identified, ...]:
    """Fit all candidates to all samples, unloading included, and return them with the best by AICc first.

    AICc (Burnham and Anderson 2002, eq. 2.4) counts grid points as independent, which neighbours on a smooth curve are
    not. It therefore favours laws with more parameters, so that the error on left-out trials is given as well.
    """
    rows = [_rows(curve) for curve in curves]
    depth_scale = float(np.median([curve.deepest_m for curve in curves]))
    force_scale = float(np.median([curve.peak_n for curve in curves]))
    speed_scale = max(curve.trial.condition.speed_m_s for curve in curves)
    trial = np.repeat(np.arange(len(rows)), [len(row) for row in rows])
    depth, force, speed, weight = np.concatenate(rows).T
    u, v, f, w = depth / depth_scale, speed / speed_scale, force / force_scale, weight * force_scale
    fold = trial % min(len(rows), MAX_FOLDS)
    out = []
    for law in LAWS:
        parameters = _fit(law, u, v, f, w, np.array([*law.start, 0.02]))
        residual = w * (_force(law, parameters, u, v) - f)
        n, k = len(residual), len(parameters) + 1
        aicc = n * np.log(max(np.mean(residual**2), 1e-12)) + 2 * k + 2 * k * (k + 1) / (n - k - 1)
        left = None
        if len(rows) > 1:
            errors = np.zeros(n)
            for number in np.unique(fold):
                kept, gone = fold != number, fold == number
                p = _fit(law, u[kept], v[kept], f[kept], w[kept], parameters)
                errors[gone] = w[gone] * (_force(law, p, u[gone], v[gone]) - f[gone])
            left = float(np.sqrt(np.mean(errors**2)))
        out.append(
            Identified(
                law=law,
                parameters=parameters,
                depth_scale_m=depth_scale,
                force_scale_n=force_scale,
                speed_scale_m_s=speed_scale,
                rms=float(np.sqrt(np.mean(residual**2))),
                aicc=float(aicc),
                left_out_rms=left,
            )
        )
    return tuple(sorted(out, key=lambda one: one.aicc))


def _rows(curve: Curve) -> Array:
    """Return (n, 4) depth, force, speed and 1 / peak at every other grid point, loading and unloading."""
    legs = [np.stack([curve.grid_m, curve.loading_n, curve.loading_m_s], 1)]
    fine = np.isfinite(curve.unloading_n)
    legs.append(np.stack([curve.grid_m, curve.unloading_n, curve.unloading_m_s], 1)[fine])
    rows = np.concatenate([leg[1::2] for leg in legs])
    return np.c_[rows, np.full(len(rows), 1 / curve.peak_n)]


def _force(law: Law, parameters: Array, u: Array, v: Array) -> Array:
    return law.force(parameters[:-1], u + parameters[-1], v)


def _fit(law: Law, u: Array, v: Array, f: Array, w: Array, start: Array) -> Array:
    from scipy.optimize import least_squares

    bounds = ([*law.low, 0.0], [*law.high, 0.3])
    start = np.clip(start, np.array(bounds[0]) + 1e-9, np.array(bounds[1]) - 1e-9)
    return least_squares(lambda p: w * (_force(law, p, u, v) - f), start, bounds=bounds, x_scale=0.3).x
