"""Why a run failed: one cause, and the figures it rests on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.scoring.c3_success import Gate
from carecontact.scoring.contact import Contact, runs
from carecontact.scoring.filters import F64
from carecontact.scoring.region import distance_to_surface, points_in_region
from carecontact.scoring.result import Attribution, FailureMode

NEAR_REGION_M = 0.030
"""A commanded path that never came this close to the region was aimed elsewhere; the upper end of what localising a
joint with these cameras leaves (p95 30 to 42 mm)."""
PATH_STEP_M = 0.005
MAX_LEG_POINTS = 2000
"""Of one commanded leg, 10 m: a target beyond any room is sampled more coarsely."""
VISION = ("rgb", "depth", "points", "masks", "landmarks")


@dataclass(frozen=True, kw_only=True)
class CommandedPath:
    """Straight lines between the commanded TCP targets, from where the TCP was. K sampled points, M targets."""

    distance: F64
    """(K,) of each point to the surface of the target region as it then lay [m], negative inside"""
    target_time_s: F64
    """(M,)"""
    target_distance: F64
    """(M,)"""

    def inside_at(self, time_s: float) -> bool:
        """Whether the target in force just before ``time_s`` lies on or under the region's surface."""
        before = int(np.searchsorted(self.target_time_s, time_s, side="left")) - 1
        return before >= 0 and bool(self.target_distance[before] <= 0.0)


def attribute(contact: Contact, gate: Gate, mode: FailureMode) -> tuple[Attribution, str]:
    """The cause of a failed run and one sentence of evidence."""
    if mode == "process_failure":
        return "process", _process_evidence(contact)
    if mode == "safety_truncation":
        return "safety", _safety_evidence(contact)
    region = contact.task.region.replace("_", " ")
    path = commanded_path(contact)
    modalities = _vision_modalities(contact)
    if path is None:
        if modalities:
            return "perception", f"The policy saw {', '.join(modalities)} and commanded no motion; why is not recorded."
        return "planning", "The policy asked for no images and commanded no motion."
    closest = float(path.distance.min())
    if closest > NEAR_REGION_M:
        where = f"The commanded path came no closer than {_mm(closest)} to the surface of the {region}"
        if modalities:
            return "perception", f"{where}, although the policy saw {', '.join(modalities)}."
        return "planning", f"{where}; the policy asked for no images."
    reach = f"{_mm(-closest)} below" if closest <= 0 else f"{_mm(closest)} above"
    where = f"The commanded path came to {reach} the surface of the {region}"
    if mode in ("no_target_contact", "off_target_contact"):
        touched = ", ".join(contact.segments[i] for i in contact.touched) or "nothing"
        return ("execution" if closest <= 0 else "planning"), f"{where}, yet the robot touched {touched}."
    if mode == "lost_contact":
        lost = [float(contact.time_s[stop]) for stop in _losses(contact)]
        inside = sum(path.inside_at(t) for t in lost)
        cause: Attribution = "execution" if 2 * inside > len(lost) else "planning"
        return cause, (
            f"Contact was lost {len(lost)} time(s), {inside} of them while the commanded target lay on or under "
            f"the surface of the {region}."
        )
    return "planning", f"{where}, but {_shortfall(contact, gate, mode)}."


def commanded_path(contact: Contact) -> CommandedPath | None:
    """The path that ``actions/pose_tcp_in_base`` describes; None if no target was ever given."""
    recording = contact.recording
    pose = recording["actions/pose_tcp_in_base"]
    given = np.isfinite(pose).all(axis=1)
    if not given.any() or len(contact.time_s) == 0:
        return None
    base = np.array(recording.header.pose_base_in_world)
    targets = pose[given, :3] @ matrix_from_quat(base[3:]).T + base[:3]
    time = recording["actions/time_s"][given]
    step = np.minimum(np.searchsorted(contact.time_s, time), len(contact.time_s) - 1)
    start = recording["scorer/pose_tcp_in_world"][step[:1], :3].astype(np.float64)

    corners = np.concatenate([start, targets])
    wanted = np.ceil(np.linalg.norm(np.diff(corners, axis=0), axis=1) / PATH_STEP_M)
    count = np.clip(wanted, 1, MAX_LEG_POINTS).astype(int)
    leg = np.repeat(np.arange(len(targets)), count)
    first = np.repeat(np.cumsum(count) - count, count)
    fraction = (np.arange(len(leg)) - first + 1) / count[leg]
    points = corners[leg] + fraction[:, None] * (corners[leg + 1] - corners[leg])

    region = recording.header.regions.index(contact.task.region)
    region_pose = recording["scorer/region_pose_in_world"][step, region].astype(np.float64)
    size = recording["scorer/region_size_m"][region]
    distance = distance_to_surface(points_in_region(points, region_pose[leg]), size)
    return CommandedPath(distance=distance, target_time_s=time, target_distance=distance[np.cumsum(count) - 1])


def _losses(contact: Contact) -> list[int]:
    """Steps at which the neighbourhood went off before the trial's end."""
    on = contact.neighbourhood_on
    return [stop for _, stop in runs(on).tolist() if stop < len(on)]


def _vision_modalities(contact: Contact) -> list[str]:
    card = contact.recording.header.card or {}
    named = card.get("modalities")
    return [m for m in cast("list[Any]", named) if m in VISION] if isinstance(named, list) else []


def _process_evidence(contact: Contact) -> str:
    header = contact.recording.header
    what = f" ({header.failure.kind}): {' '.join(header.failure.message.split()).rstrip('.')}" if header.failure else ""
    if header.ended == "harness_error":
        return f"The harness failed, not the policy{what}."
    return f"The policy's process failed{what}."


def _safety_evidence(contact: Contact) -> str:
    protocol, factor = contact.protocol, contact.protocol.phases.truncation_over_pain
    pain = np.array([protocol.f_pain(s) for s in contact.segments])
    ratio = contact.force_norm / pain
    if ratio.size:
        step, segment = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        if ratio[step, segment] >= factor:
            return (
                f"The trial was cut at {contact.force_norm[step, segment]:.1f} N on the "
                f"{contact.segments[int(segment)]} at {contact.time_s[step]:.3f} s, {ratio[step, segment]:.2f} times "
                f"its pain limit of {pain[segment]:.0f} N (cut at {factor:g})."
            )
    warnings = "; ".join(contact.recording.header.solver_warnings) or "no warning kept"
    peak = float(contact.force_norm.max(initial=0.0))
    return f"The trial was cut by the solver ({warnings}) at a peak force of {peak:.1f} N."


def _shortfall(contact: Contact, gate: Gate, mode: FailureMode) -> str:
    gates = contact.protocol.gates
    if mode == "wrong_share":
        share = contact.region_share or 0.0
        return f"only {share:.0%} of the contact impulse fell on it, {gates.region_share:.0%} needed"
    if contact.task.action == "touch":
        return f"the longest hold was {gate.longest_on_s:.2f} s of {gates.touch.duration_s:g} s"
    if contact.task.action == "push":
        return (
            f"the longest hold was {gate.longest_on_s:.2f} s of {gates.push.duration_s:g} s and the wrist moved "
            f"{_mm(gate.wrist_m)} of {_mm(gates.push.wrist_displacement_m)}"
        )
    need, best = gates.scrub, gate.best
    if best is None:
        return "there was no contact episode to judge"
    return (
        f"the best episode had {_mm(best.stroke_m)} of {_mm(need.stroke_m)} stroke, {_mm(best.extent_m)} of "
        f"{_mm(need.extent_m)} extent, {best.reversals} of {need.reversals} reversal(s) and was on for "
        f"{best.on_share:.0%} of {need.on_share:.0%}"
    )


def _mm(metres: float) -> str:
    return f"{metres * 1000:.0f} mm"
