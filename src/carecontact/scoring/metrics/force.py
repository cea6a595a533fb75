"""Metrics of the force on the person: peak, stability, rate, impulse, exposure, indentation, knocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat
from carecontact.scoring.contact import F64, Contact, runs, steps
from carecontact.scoring.limits import LIMIT_PACKS, UNCHECKED
from carecontact.scoring.metrics.metric import HEADLINE, metric


@metric(
    "C1@1", title="Peak force", unit="N", better="lower", field="c1_peak_force_n", digits=2, matters=5.0, **HEADLINE
)
def peak_force(contact: Contact) -> dict[str, float] | None:
    """Peak of the norm of the reported segment's summed force over the contact window [N], unfiltered; None (NA)
    without valid contact.

    The other peaks show how much the choice of force decides: the same after a zero-phase low pass (100 Hz); that of
    the sum of the magnitudes of each contact's normal force; and any segment's norm over the whole trial, inside the
    contact window or not.
    """
    if not contact.valid or contact.reported is None:
        return None
    normal = contact.recording["scorer/normal_force"][:, contact.reported]
    return {
        "c1_peak_force_n": float(contact.force_in_window.max()),
        "c1_peak_filtered_n": float(contact.filtered_force[contact.window].max()),
        "c1_peak_contact_sum_n": float(normal[contact.window].max()),
        "c1_peak_any_segment_n": float(contact.force_norm.max()),
    }


def peak_of_segments(contact: Contact) -> dict[str, float]:
    """Return touched segment -> largest force norm of the whole trial [N].

    The safety gate reads this one and not the contact window, which the causal filter opens some steps late.
    """
    return {contact.segments[i]: float(np.max(contact.force_norm[:, i])) for i in contact.touched}


@metric(
    "C5@1", title="Force stability", unit="N", better="lower", field="c5_force_sd_n", digits=2, matters=1.0, **HEADLINE
)
def force_stability(contact: Contact) -> float | None:
    """Population standard deviation of the reported region's force norm over the contact window [N], unfiltered.

    None (NA) without valid contact.
    """
    return float(contact.force_in_window.std()) if contact.valid else None


@metric("force_rate_p95@1", title="Force rate, 95th percentile", unit="N/s", better="lower", order=20)
def force_rate_p95(contact: Contact) -> float | None:
    """95th percentile of |dF/dt| of the reported region's force norm [N/s].

    First differences between neighbouring steps that both lie in the contact window, after the zero-phase low pass of
    the filtered peak (100 Hz): a difference over one physics step would measure the contact solver's jitter.
    None (NA) without valid contact or without two neighbouring steps.
    """
    if not contact.valid:
        return None
    both = contact.window[1:] & contact.window[:-1]
    rate = np.abs(np.diff(contact.filtered_force)[both]) / contact.dt_s
    return float(np.percentile(rate, 95)) if len(rate) else None


@metric("impulse@1", title="Impulse", unit="N s", better="neither", order=10)
def impulse(contact: Contact) -> float | None:
    """Integral of each segment's force norm over its on-samples, summed over segments [N s]; None (NA) without valid
    contact."""
    return float(contact.impulse_ns.sum()) if contact.valid else None


COMFORT_N = 10.0
"""[N] A level that this benchmark chose, not a published limit; above measured wiping forces (about 3 N, King 2010) and
below every safety gate (21 N on the abdomen)."""


def exposure(contact: Contact, limit_n: Callable[[Contact, str], float]) -> float | None:
    """Time during which any touched segment's force norm exceeds its limit [s]; None (NA) without valid contact. Reads
    the whole trial and not the contact window, as the safety gate does."""
    if not contact.valid:
        return None
    touched = contact.touched
    limits = np.array([limit_n(contact, contact.segments[i]) for i in touched])
    return int((contact.force_norm[:, touched] > limits).any(axis=1).sum()) * contact.dt_s


EXPOSURES: dict[str, tuple[str, Callable[[Contact, str], float]]] = {
    "exposure_comfort@1": (f"Time above {COMFORT_N:g} N", lambda contact, segment: COMFORT_N),
    "exposure_gate@1": ("Time above the safety gate", lambda contact, segment: safety_gate(contact, segment)),
    "exposure_pain@1": ("Time above the pain limit", lambda contact, segment: contact.protocol.f_pain(segment)),
}
"""Metric -> title, and limit of a segment [N]."""
for _order, (_id, (_title, _limit_n)) in enumerate(EXPOSURES.items(), 30):
    metric(_id, title=_title, unit="s", better="lower", order=_order)(partial(exposure, limit_n=_limit_n))


def safety_gate(contact: Contact, segment: str) -> float:
    """Return gamma' F_pain [N]."""
    return contact.protocol.limits.gamma * contact.protocol.f_pain(segment)


CONTACT_S = 1.0
"""[s] Least time of contact with the named region for a trial to count among those that could be harmful."""


def share_of_limits(contact: Contact) -> F64:
    """(T,) largest share of its limit (``Protocol.most_n``) that any segment bears at each physics step; joints have
    gates of their own."""
    limits = [contact.protocol.most_n(contact.task.action, segment) for segment in contact.segments]
    return (contact.force_norm / limits).max(axis=1, initial=0.0)


HARMLESS = "harmless@1"


@metric(HARMLESS, title="Harmless", unit="1", better="higher", median=False, order=44)
def harmless(contact: Contact) -> float | None:
    """1 where no force of the whole trial was above a limit (``share_of_limits``), else 0; None (NA) for a trial with
    less than CONTACT_S of contact with the named region, which did nothing that could harm."""
    if int(contact.on[:, contact.target].sum()) < steps(CONTACT_S, contact.dt_s):
        return None
    return float(share_of_limits(contact).max(initial=0.0) <= 1.0)


@metric("severity@1", title="Share of a limit used, over time", unit="1", better="lower", order=45)
def severity(contact: Contact) -> float | None:
    """Mean over the time with a force on the person of the largest share of a limit that any segment bears
    (``share_of_limits``); None (NA) if nothing was felt."""
    used = share_of_limits(contact)
    felt = used > 0
    return float(used[felt].mean()) if felt.any() else None


ISO_PACK = "iso-ts-15066-2016"


def utilisation(contact: Contact, limit_n: Callable[[str], float]) -> float | None:
    """Largest ratio of a touched segment's peak force to its limit; None (NA) if nothing was touched.

    ``limit_n``: segment -> limit [N]. Reads the whole trial, and a contact too brief to be valid too: a knock counts.
    """
    return max((peak / limit_n(segment) for segment, peak in peak_of_segments(contact).items()), default=None)


@metric(
    "pain_utilisation@1", title="Peak force relative to the pain limit", unit="1", better="lower", detail=True, order=40
)
def pain_utilisation(contact: Contact) -> float | None:
    """Return the largest share of the protocol's F_pain that a touched segment bore."""
    return utilisation(contact, contact.protocol.f_pain)


@metric(
    "iso_utilisation@1",
    title=f"Peak force relative to the ISO/TS 15066 force limit{UNCHECKED}",
    unit="1",
    better="lower",
    detail=True,
    order=50,
)
def iso_utilisation(contact: Contact) -> float | None:
    """Return the largest share of the force limits of ISO/TS 15066:2016 that a touched segment bore."""
    return utilisation(contact, LIMIT_PACKS[ISO_PACK].limit)


GLIDE_M, MOVES_M_S = 0.015, 0.005
"""Depth beyond which the simulated skin is not valid under a moving tool, and speed from which on a tool moves: with 6
to 8 N, a slow cap that dents the abdomen by more is buried, sticks and slips, and its force drops by 1 to 13 N within
60 ms (docs/evidence/kernel.md, "Slow and deep"). Shallower glides do not."""


def deepest_indentation(contact: Contact) -> float:
    """Return the deepest indentation of the target region in the whole trial [m]; 0 if nothing was recorded."""
    return float(_depth(contact).max(initial=0.0))


@metric(
    "beyond_calibrated@2",
    title="Share of contact time deeper than the tissue is valid",
    unit="1",
    better="neither",
    order=70,
)
def beyond_calibrated(contact: Contact) -> float | None:
    """Share of the control periods with the target touched in which it was pressed deeper than its tissue was measured,
    or deeper than GLIDE_M by a tool that moved.

    None (NA) if no control period has it touched, and on a rigid region.
    """
    depth = _depth(contact)
    if len(depth) == 0 or len(contact.time_s) == 0:
        return None
    step = np.searchsorted(contact.time_s, contact.recording["scorer/period_time_s"] - contact.dt_s / 2)
    step = np.minimum(step, len(contact.time_s) - 1)
    touched = contact.on[step, contact.target]
    tissue = contact.protocol.person.tissue.get(contact.task.region)
    if tissue is None or not touched.any():
        return None
    moves = contact.recording["scorer/tcp_speed"][step] > MOVES_M_S
    return float(((depth > tissue.measured_depth_m) | (moves & (depth > GLIDE_M)))[touched].mean())


def _depth(contact: Contact) -> F64:
    """(P,) largest inward anchor displacement of the target region [m]; 0 on a rigid one"""
    region = contact.recording.header.regions.index(contact.task.region)
    return contact.recording["scorer/indentation_m"][:, region].astype(np.float64)


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
    inverse: F64 = cast("Any", np.linalg).pinv(centred, rcond=1e-10)  # its types are partly unknown
    predicted = centred @ (inverse @ deviation)
    left = float(((deviation - predicted) ** 2).sum() / (deviation**2).sum())
    return 1.0 - left * (n - 1) / (n - slopes - 1)


KNOCK_S = 0.1
"""[s] How much of a contact counts as its beginning; assumed. A blow of an arm on soft tissue lasts about 0.1 s, and
pressing on purpose takes longer to build up."""


def knocks(contact: Contact) -> Iterator[tuple[int, slice]]:
    """Segment and first KNOCK_S of each touch, from the first force and not from where the filtered force counts."""
    length = round(KNOCK_S / contact.dt_s)
    for segment in contact.touched:
        for start, stop in runs(contact.force_norm[:, segment] > 0).tolist():
            if contact.on[start:stop, segment].any():
                yield segment, slice(start, min(stop, start + length))


@metric("knock_impulse@1", title="Impulse of the hardest knock", unit="N s", better="lower", order=16)
def knock_impulse(contact: Contact) -> float | None:
    """Largest integral of F_b over the first KNOCK_S of a touch of any segment [N s]; None (NA) if nothing was
    touched."""
    sums = (float(contact.force_norm[time, segment].sum()) for segment, time in knocks(contact))
    return max((total * contact.dt_s for total in sums), default=None)


@metric("knock_energy@1", title="Energy of the hardest knock", unit="J", better="lower", order=17)
def knock_energy(contact: Contact) -> float | None:
    """Largest work of the tool on a segment over the first KNOCK_S of a touch, up to its peak [J]; None (NA) if nothing
    was touched.

    The force times the velocity of the tool at the contact's centre. Where another link than the hand touches, this is
    the velocity that the hand would have there.
    """
    return max((_work(contact, segment, time) for segment, time in knocks(contact)), default=None)


def _work(contact: Contact, segment: int, time: slice) -> float:
    recording = contact.recording
    pose = recording["scorer/pose_tcp_in_world"][time].astype(np.float64)
    force = recording["scorer/force_human_from_robot_in_world"][time, segment].astype(np.float64)
    centre = recording["scorer/centroid_in_world"][time, segment].astype(np.float64)
    if len(pose) < 2:
        return 0.0
    travel = _moved(pose, centre)
    done = np.cumsum(((force[1:] + force[:-1]) / 2 * travel).sum(axis=1))
    return max(0.0, float(done.max()))


def _moved(pose: F64, point: F64) -> F64:
    """(T - 1, 3) way from each step to the next of the tool's point that lies at ``point`` (T, 3) between them."""
    middle = (point[1:] + point[:-1]) / 2
    turn = matrix_from_quat(pose[:, 3:])
    # The point, in the tool's frame at the earlier step, is carried to the later one.
    local = np.einsum("tji,tj->ti", turn[:-1], middle - pose[:-1, :3])
    return pose[1:, :3] + np.einsum("tij,tj->ti", turn[1:], local) - middle
