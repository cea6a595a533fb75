"""Why a trial failed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from carecontact.interface.regions import REGIONS
from carecontact.recording.notes import JOINTS, perception_errors
from carecontact.recording.reason import reason_of
from carecontact.scoring.behaviour import Gate, ask, mm
from carecontact.scoring.commanded import (
    CommandedPath,
    commanded_contact,
    commanded_path,
    nearest_noted_target,
    noted_reason,
    noted_subtasks,
)
from carecontact.scoring.contact import Contact, faint_press, runs
from carecontact.scoring.foam import FoamCleaning, place_share
from carecontact.scoring.metrics.success import broken
from carecontact.scoring.result import Attribution, FailureMode
from carecontact.scoring.verdict import farthest_beyond

LOCATED = frozenset(("depth", "points", "masks", "landmarks"))
"""Modalities from which a place is computed; with fewer the key points or the mask must do."""
PERSON_IOU = 0.5


@dataclass(frozen=True, kw_only=True)
class Sight:
    """Counts of views: one camera in one observation, with key points or masks."""

    views: int = 0
    visible: int = 0
    """Number of views in which every joint at the region's ends was visible"""
    found: int = 0
    """Number of these views from whose modalities the region can be found"""
    error_m: float | None = None
    """Median horizontal error of the places that they led to; None where none was computed"""


def sight(contact: Contact) -> Sight:
    """Count the views. A computed place counts as the region up to a horizontal error of NEAR_REGION_M."""
    rows, region = perception_errors(contact.recording), contact.task.region
    names = REGIONS[region].sight_joints
    if rows is None or not len(rows.camera) or not names:
        return Sight()
    joints = [list(JOINTS).index(name) for name in names]
    visible = rows.joint_visible[:, joints].all(axis=1)
    column = contact.recording.header.regions.index(region)
    error = np.linalg.norm(rows.target_error_m[:, column, :2].astype(np.float64), axis=1)
    if set(modalities(contact)) >= LOCATED:
        found = error <= NEAR_REGION_M
    else:
        found = np.isfinite(rows.landmark_error_px[:, joints]).all(axis=1) | (rows.human_iou >= PERSON_IOU)
    computed = error[np.isfinite(error) & visible]
    return Sight(
        views=len(rows.camera),
        visible=int(visible.sum()),
        found=int((visible & found).sum()),
        error_m=float(np.median(computed)) if len(computed) else None,
    )


def modalities(contact: Contact) -> list[str]:
    """Return the modalities that the policy's card requests; empty if the policy never sent a card."""
    named = (contact.recording.header.card or {}).get("modalities")
    return [m for m in cast("list[Any]", named) if isinstance(m, str)] if isinstance(named, list) else []


NEAR_REGION_M = 0.030
"""Aimed farther beside the region than this is aimed elsewhere; the upper end of what localising a joint with these
cameras leaves (p95 30 to 42 mm)."""
MOST_SUBTASKS = 3
"""Most subtasks of a policy's notes that the evidence repeats."""
NO_MOTION, BESIDE, SOLVER = "No motion was commanded", " beside the ", "The trial was cut by the solver"
"""Words of the evidence by which those who read it tell apart what one cause can mean."""
VISION = ("rgb", "depth", "points", "masks", "landmarks")


def attribute(contact: Contact, gate: Gate, mode: FailureMode) -> tuple[Attribution, str]:
    """Return the cause of a failed trial and one sentence of evidence. Perception is blamed only if the path was aimed
    beside a region that could be seen, unless the policy's notes show that it chose that place."""
    if mode == "process_failure":
        return "process", _process_evidence(contact)
    if mode == "safety_truncation":
        return "safety", _safety_evidence(contact)
    if mode == "joint_beyond_range":
        joint, beyond_rad, time_s = farthest_beyond(contact.recording)
        return "safety", (
            f"The {joint.replace('_', ' ')} was {beyond_rad:.3f} rad beyond its range at {time_s:.3f} s; "
            f"the protocol allows {contact.protocol.gates.joint_beyond_rad:.3f} rad."
        )
    cause, evidence = _of_contact(contact, gate, mode)
    return cause, f"{evidence} {_by_part(contact)}" if mode == "not_by_tool" else evidence


def _of_contact(contact: Contact, gate: Gate, mode: FailureMode) -> tuple[Attribution, str]:
    path = commanded_path(contact)
    if path is None:
        seen, reason = sight(contact), noted_reason(contact)
        noted = f' The policy noted: "{reason}".' if reason else ""
        cause: Attribution = "perception" if seen.visible and not seen.found else "planning"
        return cause, f"{NO_MOTION}; {_views(contact, seen)}.{noted}"
    if path.closest_m > NEAR_REGION_M and path.beside_m > NEAR_REGION_M:
        return _aimed_elsewhere(contact, path, sight(contact))
    return _aimed_right(contact, gate, mode, path)


def _aimed_elsewhere(contact: Contact, path: CommandedPath, seen: Sight) -> tuple[Attribution, str]:
    where = f"The commanded path was aimed {mm(path.beside_m)}{BESIDE}{_region(contact)}"
    could_be_found = seen.found or not seen.visible
    noted = nearest_noted_target(contact) if could_be_found else None
    if noted is not None:
        name = f' ("{noted.name}")' if noted.name else ""
        place = "over it" if noted.beside_m == 0.0 else f"{mm(noted.beside_m)} beside it"
        other = f", over the {noted.over.replace('_', ' ')}" if noted.over else ""
        chosen = f"the target that the policy noted{name} lay {place}{other}"
        return "planning", f"{where}: {chosen}; {_views(contact, seen)}."
    if could_be_found and (subtasks := noted_subtasks(contact)):
        listed = ", ".join(f'"{text}"' for text in subtasks[:MOST_SUBTASKS])
        return "planning", f"{where}: the policy noted {listed} and no target; {_views(contact, seen)}."
    return ("perception" if seen.visible else "planning"), f"{where}; {_views(contact, seen)}."


def _aimed_right(contact: Contact, gate: Gate, mode: FailureMode, path: CommandedPath) -> tuple[Attribution, str]:
    region, closest = _region(contact), path.closest_m
    reach = f"{mm(-closest)} below" if closest <= 0 else f"{mm(closest)} above"
    where = f"The commanded path came to {reach} the surface of the {region}"
    if closest > NEAR_REGION_M:
        where = f"The commanded path was aimed at the {region} and stayed {mm(closest)} off its surface"
    if mode in ("no_target_contact", "off_target_contact"):
        joint = ", yet the robot" if closest <= 0 else "; the robot"
        return ("execution" if closest <= 0 else "planning"), f"{where}{joint} {_touched(contact)}."
    if mode == "lost_contact":
        on = contact.neighbourhood_on
        lost = [float(contact.time_s[stop]) for _, stop in runs(on).tolist() if stop < len(on)]
        inside = sum(path.inside_at(t) for t in lost)
        cause: Attribution = "execution" if 2 * inside > len(lost) else "planning"
        if len(lost) == 1:
            side = "on or under" if inside else "above"
            return cause, f"Contact was lost once, while the commanded target lay {side} the surface of the {region}."
        return cause, (
            f"Contact was lost {len(lost)} times; in {inside} of them, the commanded target lay on or under the "
            f"surface of the {region}."
        )
    gates, share = contact.protocol.gates, contact.region_share or 0.0
    table = gates.of(contact.task.action)
    if mode == "wrong_share":
        lacking = f"only {share:.0%} of the contact impulse fell on it, {gates.region_share:.0%} needed"
        if gates.foam is not None and share >= gates.region_share:
            near = place_share(contact, gates.foam.within_m) or 0.0
            lacking = (
                f"only {near:.0%} of the contact impulse came from the tool within {mm(gates.foam.within_m)} of the "
                f"foam's middle, {gates.foam.impulse_share:.0%} needed"
            )
    elif gate.action_met and not gate.conduct_met:
        lacking = broken(gate.conduct)
    else:
        lacking = ask(contact, "shortfall", contact, table, gate)
    if mode == "insufficient_progress" and FoamCleaning.of(contact) is None:
        # What the targets under the surface asked for, if a tool that followed them would pass the gate.
        asked = ask(contact, "requested", table, commanded_contact(path, contact.protocol.contact.reversal_m))
        if asked:
            return "execution", f"{where} and asked for {asked}, but {lacking}."
    return "planning", f"{where}, but {lacking}."


def _touched(contact: Contact) -> str:
    if contact.touched:
        return f"touched {', '.join(contact.segments[i] for i in contact.touched)}"
    return faint_press(contact) or "touched nothing"


def _by_part(contact: Contact) -> str:
    """Return which part of the robot touched the region or beside it, where most of it was not the tool."""
    pressed = contact.recording["scorer/beside_normal_force"][:, :, contact.neighbourhood].sum(axis=(0, 2))
    part = ("hand", "links")[int(pressed.argmax())]
    share = f"{contact.tool_share or 0.0:.0%} of the contact impulse"
    return f"The {_region(contact)} was touched by the {part}, not by the tool, which applied {share}."


def _views(contact: Contact, seen: Sight) -> str:
    """Return what the policy could see of the region, as far as the recording says."""
    region, asked = _region(contact), [m for m in modalities(contact) if m in VISION]
    if not asked:
        return "the policy asked for no images"
    if not seen.views:
        return f"the policy saw {', '.join(asked)}, and whether the {region} was in view is not recorded"
    if not seen.visible:
        return f"the {region} was hidden in {'its only view' if seen.views == 1 else f'all {seen.views} views'}"
    error = f" (middle error {mm(seen.error_m)})" if seen.error_m is not None else ""
    return f"the {region} was in view in {seen.visible} of {seen.views} and could be found in {seen.found}{error}"


def _region(contact: Contact) -> str:
    return contact.task.region.replace("_", " ")


def _process_evidence(contact: Contact) -> str:
    header = contact.recording.header
    failure = header.failure
    what = f" ({failure.kind}): {' '.join(reason_of(failure).split()).rstrip('.')}" if failure else ""
    who = "The harness failed, not the policy" if header.ended == "harness_error" else "The policy's process failed"
    return f"{who}{what}."


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
    return f"{SOLVER} ({warnings}) at a peak force of {peak:.1f} N."
