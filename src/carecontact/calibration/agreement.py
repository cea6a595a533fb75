"""How well a simulated press agrees with a measured one, in force, stiffness and lost work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carecontact.calibration.trial import Array

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
    """Compare forces at depths (n,) [m]. ``measured``, ``simulated``: loading and unloading forces (n,) [N], nan where
    there are none.
    """
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
    """Return the work [J] that both loops enclose at depths where both have both ways; None if these are too few.

    See LEAST_LOSS.
    """
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
    other values.
    """
    values = {name: np.array([getattr(row, name) for row in rows]) for name in POOLED[:-1]}
    means: dict[str, float | None] = {name: float(one.mean()) for name, one in values.items()}
    return means | {
        "nrmse": float(np.sqrt(np.mean(values["nrmse"] ** 2))), "work_error": work_error([one.work_j for one in rows]),
    }  # fmt: skip
