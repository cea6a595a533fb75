"""Force over depth from a trial's samples, without the baseline and with depth zero at touch, and the simple law that
describes it best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.lab.calibration.trial import Array, Trial

GRID = np.linspace(0.025, 1.0, 40)
"""Depths at which forces are compared, as shares of a trial's deepest point."""
TOUCH_SHARE = 0.02
"""Touch is where the force first exceeds the largest of three values: this share of the peak, the preload, and three
times the noise."""
MIN_FREE_SAMPLES = 5
PATH_STEP_S = 0.002
SPIKE_SHARE = 0.1
FLAT = 0.1
"""A force whose slope over depth is below this share of the secant stiffness has a plateau. The tangent of soft tissue
grows with depth."""
FLAT_SHARES = (0.6, 0.45, 0.3, 0.15)
"""Parts of the loading, from the deepest point up, in which a plateau is looked for."""
CONSTANT_SHARE = 0.05
"""A largest force that stays the same to the last digit over this share of the depth is a limit of the sensor."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One trial with its depth counted from touch. Its simulations count from the same force, so that measurement and
    simulation share the bias of this rule."""

    trial: Trial
    touch_force_n: float
    """Force at depth zero."""
    noise_n: float
    """Standard deviation about the baseline, or of second differences where nothing was recorded out of contact."""
    drift_n_s: float
    depth_m: Array
    """(n,) depth of every sample"""
    force_n: Array
    """(n,) force of every sample without the baseline"""
    deepest_m: float
    loading_n: Array
    """(40,) force at GRID * deepest_m"""
    unloading_n: Array
    """(40,) force while unloading; nan if the trial does not unload"""
    path_s: Array
    """(p,) evenly spaced times of the smoothed path"""
    path_m: Array
    """(p,) depth of the path past touch"""
    loading_m_s: Array
    """(40,) speed of the path at GRID * deepest_m"""
    unloading_m_s: Array
    """(40,) the same while unloading, negative; nan if the trial does not unload"""

    @property
    def grid_m(self) -> Array:
        return GRID * self.deepest_m

    @property
    def peak_n(self) -> float:
        return float(self.loading_n[-1])


def make_curve(trial: Trial) -> Curve:
    """Make the curve of a trial. Raises ConfigError if its force never rises clearly above its own noise."""
    load, unload = trial.phase == 0, trial.phase == 2
    free = _free_samples(trial)
    time, raw = trial.time_s, despiked(trial.force_n)
    # Second differences contain noise alone; they are used if nothing was recorded out of contact.
    offset, drift, noise = 0.0, 0.0, float(np.std(np.diff(trial.force_n[load], 2)) / np.sqrt(6))
    if free.sum() >= MIN_FREE_SAMPLES:
        # A slope that is fitted to a small part of the trial would give large errors in the rest.
        slope = np.ptp(time[free]) > 0.3 * np.ptp(time)
        fit = np.polyfit(time[free], raw[free], 1 if slope else 0)
        drift, offset = (float(fit[0]), float(fit[1])) if slope else (0.0, float(fit[0]))
        noise = float(np.std(raw[free] - np.polyval(fit, time[free])))
    force = raw - offset - drift * time
    peak = float(np.median(force[load][-3:]))
    touch_force = max(trial.preload_n, TOUCH_SHARE * peak, 3 * noise)
    if touch_force > 0.3 * peak:
        raise ConfigError(
            f"trial {trial.trial_id!r}: its peak of {peak:.3g} N is too close to its preload ({trial.preload_n:g} N) "
            f"or its noise ({noise:.2g} N); leave the trial out"
        )
    depth, f = trial.indentation_m[load], force[load]
    if free.sum() < MIN_FREE_SAMPLES:
        touch_force = max(float(np.median(f[:3])), touch_force)
    zero = _crossing(depth, f, touch_force)
    deepest = float(depth.max() - zero)
    grid = GRID * deepest
    path_s, path = _smooth_path(trial, zero)
    path_speed = np.gradient(path, path_s)
    turn = int(path.argmax())
    inward, outward = path_s <= max(float(time[load][-1]), path_s[turn]), path_s >= path_s[turn]
    unloading, unloading_speed = np.full((2, len(GRID)), np.nan)
    if trial.unloads:
        back = trial.indentation_m[unload] - zero
        unloading = _on_grid(back, force[unload], grid)
        unloading[grid < back.min() - 0.02 * deepest] = np.nan
        unloading_speed = np.interp(grid, path[outward][::-1], path_speed[outward][::-1])
    return Curve(
        trial=trial,
        touch_force_n=touch_force,
        noise_n=noise,
        drift_n_s=drift,
        depth_m=trial.indentation_m - zero,
        force_n=force,
        deepest_m=deepest,
        loading_n=_on_grid(depth - zero, f, grid),
        unloading_n=unloading,
        path_s=path_s,
        path_m=path,
        loading_m_s=np.interp(grid, path[inward], path_speed[inward]),
        unloading_m_s=np.where(np.isfinite(unloading), unloading_speed, np.nan),
    )


def plateau_m(curve: Curve) -> float | None:
    """Return the depth from which the force stays the same while the press goes deeper; None if it never does.

    Only the part at full speed counts, because a force that depends on speed also falls where the press slows down.
    """
    secant = curve.peak_n / curve.deepest_m
    moving = curve.loading_m_s >= 0.5 * np.median(curve.loading_m_s)
    for share in FLAT_SHARES:
        part = moving & (GRID >= 1 - share)
        if part.sum() > 3 and np.polyfit(curve.grid_m[part], curve.loading_n[part], 1)[0] < FLAT * secant:
            return (1 - share) * curve.deepest_m
    load = curve.trial.phase == 0
    raw, depth = curve.trial.force_n[load], curve.depth_m[load]
    values = np.unique(raw)
    step = float(np.diff(values).min(initial=np.inf)) if len(values) > 1 else 0.0
    top = depth[raw == raw.max()]
    # A gauge of few digits repeats every value.
    if len(top) >= MIN_FREE_SAMPLES and np.ptp(top) > max(CONSTANT_SHARE * curve.deepest_m, 3 * step / secant):
        return float(top.min())
    return None


def despiked(force: Array) -> Array:
    """Replace spikes of one or two samples, which differ from the median of five by more than a tenth of the range, by
    that median."""
    out = force.copy()
    middle = np.median(np.lib.stride_tricks.sliding_window_view(force, 5), axis=1)
    low, high = np.percentile(force, [2, 98])
    out[2:-2] = np.where(np.abs(force[2:-2] - middle) > SPIKE_SHARE * (high - low), middle, force[2:-2])
    return out


def _smooth_path(trial: Trial, zero: float) -> tuple[Array, Array]:
    """Return the path of replays: even times, and the depth past touch, smoothed over a twelfth of the loading."""
    from scipy.signal import savgol_filter

    loading_s = float(np.ptp(trial.time_s[trial.phase == 0]))
    step = min(PATH_STEP_S, loading_s / 60)
    time = np.arange(trial.time_s[0], trial.time_s[-1] + step / 2, step)
    depth = np.interp(time, trial.time_s, trial.indentation_m) - zero
    window = min(2 * round(loading_s / step / 24) + 1, len(depth) - (len(depth) + 1) % 2)
    return time, np.asarray(savgol_filter(depth, max(window, 5), 2))


def _free_samples(trial: Trial) -> npt.NDArray[np.bool_]:
    """Return which samples are out of contact: those before the corner of a hinge fitted to the beginning of the
    loading, and those after release at the same depth."""
    load = np.flatnonzero(trial.phase == 0)
    time, depth, force = trial.time_s[load], trial.indentation_m[load], despiked(trial.force_n)[load]
    start = float(np.median(force[: max(3, len(force) // 50)]))
    window = max(1, len(force) // 30)
    calm = np.convolve(force, np.ones(window) / window, mode="same")
    below = np.flatnonzero(calm[: -window or None] - start <= 0.12 * (force[-3:].mean() - start))
    upto = max(int(below[-1]) + 1 if len(below) else 0, 3)
    out = np.zeros(len(trial.time_s), bool)
    if upto < 2 * MIN_FREE_SAMPLES:
        return out
    best, hinge = np.inf, depth[0]
    for candidate in np.linspace(depth[0], depth[upto - 1], 40):
        basis = np.stack([np.ones(upto), np.maximum(depth[:upto] - candidate, 0.0)], 1)
        error = float(np.sum((force[:upto] - basis @ np.linalg.lstsq(basis, force[:upto], rcond=None)[0]) ** 2))
        if error < best:
            best, hinge = error, candidate
    # The hinge is straight and the real curve bent, so that the true touch lies a little before the corner.
    clear = hinge - 0.25 * (depth[upto - 1] - hinge)
    out[load] = (trial.indentation_m[load] < clear) & (time < time[upto - 1])
    after = np.flatnonzero(trial.phase == 2)
    out[after] = trial.indentation_m[after] < clear - 0.05 * np.ptp(depth)
    return out


def _crossing(depth: Array, force: Array, threshold: float) -> float:
    """Return the depth from which the force stays above the threshold, by a parabola through the samples around it."""
    below = np.flatnonzero(force <= threshold)
    if not len(below):
        return float(depth[0])
    # Noise crosses the threshold many times: take the middle of the first sample above it and the last below it.
    first, last = int(np.argmax(force > threshold)), int(below[-1])
    guess = float((depth[first] + depth[last]) / 2)
    above = depth[np.argmax(force > 3 * threshold)]
    reach = max(float(above - guess), 1e-5)
    near = (depth > guess - reach) & (depth < guess + reach)
    if near.sum() < 6:
        return guess
    c2, c1, c0 = np.polyfit(depth[near] - guess, force[near], 2)
    roots = np.roots([c2, c1, c0 - threshold])
    roots = roots[np.isreal(roots)].real
    roots = roots[(np.abs(roots) < reach) & (2 * c2 * roots + c1 > 0)]
    return guess + float(roots[np.abs(roots).argmin()]) if len(roots) else guess


def _on_grid(depth: Array, force: Array, grid: Array) -> Array:
    """Return the means of the samples nearest to each depth of an even grid, interpolated where there are none."""
    step = grid[1] - grid[0]
    index = np.rint((depth - grid[0]) / step).astype(int)
    inside = (index >= 0) & (index < len(grid))
    count = np.bincount(index[inside], minlength=len(grid))
    mean_force = np.bincount(index[inside], force[inside], minlength=len(grid))
    mean_depth = np.bincount(index[inside], depth[inside], minlength=len(grid))
    order = np.argsort(depth)
    filled = count >= 3
    sparse = order[~filled[np.clip(index[order], 0, len(grid) - 1)]]
    knots = np.r_[mean_depth[filled] / count[filled], depth[sparse]]
    values = np.r_[mean_force[filled] / count[filled], force[sparse]]
    order = np.argsort(knots)
    return np.interp(grid, knots[order], values[order])


MAX_FOLDS = 20
"""Up to this number, trials are left out one by one; more trials are left out in this number of groups."""


@dataclass(frozen=True, kw_only=True)
class Law:
    """Force over depth and speed, both scaled to the trials (u = 1 at the median deepest point, f = 1 at its force)."""

    name: str
    formula: str
    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    force: Callable[[Array, Array, Array], Array]


LAWS = (
    Law(
        name="linear", formula="k d", start=(1.0,), low=(0.0,), high=(10.0,),
        force=lambda p, u, v: p[0] * u,
    ),
    Law(
        name="quadratic", formula="k1 d + k2 d^2", start=(0.5, 0.5), low=(0.0, -5.0), high=(10.0, 10.0),
        force=lambda p, u, v: p[0] * u + p[1] * u**2,
    ),
    Law(
        name="exponential", formula="A (exp(d / delta) - 1)", start=(0.5, 1.0), low=(1e-4, 0.1), high=(100.0, 100.0),
        force=lambda p, u, v: p[0] * np.expm1(u / p[1]),
    ),
    Law(
        name="hunt-crossley", formula="k d^n (1 + beta v)", start=(1.0, 1.3, 0.0), low=(0.0, 0.5, 0.0),
        high=(10.0, 4.0, 100.0), force=lambda p, u, v: p[0] * u ** p[1] * (1 + p[2] * v),
    ),
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
        scales = {"depth_scale_m": depth_scale, "force_scale_n": force_scale, "speed_scale_m_s": speed_scale}
        rms = float(np.sqrt(np.mean(residual**2)))
        out.append(Identified(law=law, parameters=parameters, rms=rms, aicc=float(aicc), left_out_rms=left, **scales))
    return tuple(sorted(out, key=lambda one: one.aicc))


def _rows(curve: Curve) -> Array:
    """Return (n, 4) depth, force, speed and 1 / peak at every other grid point, loading and unloading."""
    legs = [(curve.loading_n, curve.loading_m_s), (curve.unloading_n, curve.unloading_m_s)]
    stacked = [np.stack([curve.grid_m, force, speed], 1)[np.isfinite(force)] for force, speed in legs]
    rows = np.concatenate([leg[1::2] for leg in stacked])
    return np.c_[rows, np.full(len(rows), 1 / curve.peak_n)]


def _force(law: Law, parameters: Array, u: Array, v: Array) -> Array:
    return law.force(parameters[:-1], u + parameters[-1], v)


def _fit(law: Law, u: Array, v: Array, f: Array, w: Array, start: Array) -> Array:
    from scipy.optimize import least_squares

    bounds = ([*law.low, 0.0], [*law.high, 0.3])
    start = np.clip(start, np.array(bounds[0]) + 1e-9, np.array(bounds[1]) - 1e-9)
    return least_squares(lambda p: w * (_force(law, p, u, v) - f), start, bounds=bounds, x_scale=0.3).x
