"""How well a simulated press agrees with a measured one, in force, stiffness and lost work."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from carecontact.calibration.trial import Array

UPPER = 0.5
"""Tangent stiffness is the slope over the depths from this share of the deepest point on."""


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
    loop_error: float | None
    """Relative error of the work lost between loading and unloading; None without unloading."""


def agreement(depth: Array, measured: tuple[Array, Array], simulated: tuple[Array, Array]) -> Agreement:
    """Compare forces at depths (n,) [m]. ``measured``, ``simulated``: loading and unloading forces (n,) [N], nan where
    there are none.
    """
    both = np.isfinite(measured[0]) & np.isfinite(simulated[0])
    d, m, s = depth[both], measured[0][both], simulated[0][both]
    back = np.isfinite(measured[1]) & np.isfinite(simulated[1])
    measured_all = np.r_[m, measured[1][back]]
    simulated_all = np.r_[s, simulated[1][back]]
    difference = simulated_all - measured_all
    loop = None
    if back.sum() > 3:
        common = both & back
        lost = [
            np.trapezoid((legs[0] - legs[1])[common], depth[common]) for legs in (measured, simulated)
        ]  # fmt: skip
        loop = float(lost[1] / lost[0] - 1) if lost[0] > 0 else None
    return Agreement(
        nrmse=float(np.sqrt(np.mean(difference**2)) / m[-1]),
        r2=float(1 - np.sum(difference**2) / np.sum((measured_all - measured_all.mean()) ** 2)),
        peak_error=float(s[-1] / m[-1] - 1),
        tangent_error=tangent(d, s) / tangent(d, m) - 1,
        loop_error=loop,
    )


def tangent(depth: Array, force: Array) -> float:
    """Return the slope of the force over the deeper half of the depths [N/m]."""
    upper = depth >= UPPER * depth[-1]
    return float(np.polyfit(depth[upper], force[upper], 1)[0])


def pooled(rows: list[Agreement]) -> dict[str, float | None]:
    """Pool the agreement of trials: the root mean square of ``nrmse`` and the means of all other values."""
    out: dict[str, float | None] = {}
    for field in fields(Agreement):
        values = np.array([v for row in rows if (v := getattr(row, field.name)) is not None])
        if not len(values):
            out[field.name] = None
        elif field.name == "nrmse":
            out[field.name] = float(np.sqrt(np.mean(values**2)))
        else:
            out[field.name] = float(values.mean())
    return out
