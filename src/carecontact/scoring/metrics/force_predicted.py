"""force_predicted_r2@1: how well the contact force follows from what the policy knew without a force sensor."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat
from carecontact.scoring.contact import Contact
from carecontact.scoring.filters import F64
from carecontact.scoring.metrics.metric import metric

LEAST_PERIODS = 35
"""Five control periods for each of the seven coefficients, 0.7 s of contact at 50 Hz."""
LEAST_SD_N = 1e-3
"""A force steadier than this has no variance to explain."""


@metric(
    "force_predicted_r2@1",
    title="R² of force predicted from commands and encoders",
    unit="1",
    better="neither",
    order=80,
)
def force_predicted_r2(contact: Contact) -> float | None:
    """Adjusted R^2 of F_b of the reported segment, least squares over the control periods of the contact window.

    Predictors are what a policy commanded and what its encoders report: stiffness times the distance from tool to
    impedance target, the force that the controller's spring commands, and the tool's velocity, which its damper
    brakes; three components each, in the robot's base, and a constant. 1: no force sensor was needed to know the
    force; 0: they do not predict it. Adjusted for the six slopes (Ezekiel, Methods of Correlation Analysis, 1930), so
    slightly below 0 is possible. The fit is the trial's own: information that is there, not a predictor that works
    elsewhere.

    None (NA) without valid contact, in fewer than LEAST_PERIODS periods, without an action, or where the force stays
    the same.
    """
    if not contact.valid or contact.reported is None:
        return None
    recording = contact.recording
    time = recording["scorer/period_time_s"]
    given = recording["actions/time_s"]
    if len(time) == 0 or len(given) == 0:
        return None
    step = np.clip(np.searchsorted(contact.time_s, time - contact.dt_s / 2), 0, len(contact.time_s) - 1)
    kept = contact.window[step]
    force = contact.force_norm[step, contact.reported][kept]
    if len(force) < LEAST_PERIODS or force.std() < LEAST_SD_N:
        return None
    step = step[kept]
    action = np.maximum(np.searchsorted(given, time[kept] - contact.dt_s / 2, side="right") - 1, 0)
    # A joint control has no stiffness of the tool: one that is constant fits as well, whatever its value.
    in_joints = "actions/joint" in recording.arrays
    stiffness = np.ones((len(action), 1)) if in_joints else recording["actions/stiffness"][action, :1]
    target = recording["scorer/target_in_base"][kept, :3].astype(np.float64)
    before, after = np.maximum(step - 1, 0), np.minimum(step + 1, len(contact.time_s) - 1)
    apart_s = (after - before)[:, None] * contact.dt_s
    velocity = (_tool_in_base(contact, after) - _tool_in_base(contact, before)) / apart_s
    spring = stiffness * (target - _tool_in_base(contact, step))
    return _adjusted_r2(force, np.concatenate([spring, velocity], axis=1))


def _tool_in_base(contact: Contact, step: npt.NDArray[np.int64]) -> F64:
    """(N, 3) tool point at these physics steps [m]."""
    base = np.array(contact.recording.header.pose_base_in_world)
    tool = contact.recording["scorer/pose_tcp_in_world"][step, :3].astype(np.float64)
    return (tool - base[:3]) @ matrix_from_quat(base[3:])


def _adjusted_r2(values: F64, predictors: F64) -> float:
    """``predictors``: (N, P), N > P + 1; a constant is added."""
    n, slopes = predictors.shape
    if not np.isfinite(predictors).all():
        return float("nan")  # which no score may be: the caller names the recording
    centred = predictors - predictors.mean(axis=0)
    # A tool that never moved along an axis gives no slope there; scaled, so that newtons and m/s are cut off alike.
    spread = centred.std(axis=0)
    centred = centred / np.where(spread > 0, spread, 1.0)
    deviation = values - values.mean()
    linalg: Any = import_module("numpy.linalg")  # its types are partly unknown
    coefficients: F64 = linalg.pinv(centred, rcond=1e-10) @ deviation
    told = centred @ coefficients
    left = float(((deviation - told) ** 2).sum() / (deviation**2).sum())
    return 1.0 - left * (n - 1) / (n - slopes - 1)
