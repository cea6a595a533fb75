"""How far a trial has come toward its gate while it goes on: what the score would say if it ended now, in numbers. For
the rewards of a learner that is given the truth, and no score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.recording.schema import Recording
from carecontact.scoring.behaviour import ask
from carecontact.scoring.contact import HELD_S, find_contact, held_force, steps
from carecontact.scoring.metrics.success import judge, measure
from carecontact.scoring.progress import distance_to_surface, points_in_region, region_pose
from carecontact.scoring.verdict import reach_verdict

NEEDED = (
    *("scorer/time_s", "scorer/force_human_from_robot_in_world", "scorer/normal_force", "scorer/pose_tcp_in_world"),
    *("scorer/region_pose_in_world", "scorer/wrist_in_world", "scorer/human_joint_position"),
)
"""The streams of a trial that gates and verdict read; where there are any, those under ``scorer/beside_*`` too."""
NEARLY = 0.999
"""Largest share of a gate that is not met, where rounding would make it 1."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    share: float
    """How much of its gate the trial has reached, from 0 to 1 (``Behaviour.reached``); 1 exactly where it meets every
    part of it. It may fall again, for example where the force leaves the band while the tool slides."""
    success: bool
    """Whether the gate is met, with valid contact (C3)."""
    safety_gated: bool
    """The verdict of the exam: success in the right region, without too much force on any part of the person."""
    safe: bool
    """No force above its safety gate so far, and no joint beyond its range by more than the gate for joints allows."""
    force_n: float
    """Mean force on the neighbourhood of the named region over the last HELD_S / 2 [N]."""
    elsewhere_n: float
    """Largest force on any other segment in that time [N]."""
    distance_m: float
    """From the tool centre point to the region's surface [m]; negative inside (``progress.distance_to_surface``)."""


def progress_of(recording: Recording) -> Progress:
    """Return the progress up to the end of the streams, at least one physics step; NEEDED and constants suffice."""
    contact = find_contact(recording)
    table = contact.protocol.gates.of(contact.task.action)
    gate = judge(contact, measure(contact, needed=True))
    verdict = reach_verdict(contact, gate)
    last = max(1, steps(HELD_S / 2, contact.dt_s))
    others = np.delete(contact.force_norm[-last:], contact.neighbourhood, axis=1)
    end = np.array([len(contact.time_s) - 1])
    pose, size = region_pose(contact, contact.task.region, end)
    tool = recording["scorer/pose_tcp_in_world"][end, :3].astype(np.float64)
    return Progress(
        share=1.0 if gate.action_met else float(np.clip(ask(contact, "reached", contact, table, gate), 0.0, NEARLY)),
        success=gate.success,
        safety_gated=verdict.safety_gated,
        safe=not verdict.over_limit and not verdict.joints_beyond,
        force_n=float(held_force(contact)[-1]),
        elsewhere_n=float(others.max(initial=0.0)),
        distance_m=float(distance_to_surface(points_in_region(tool, pose), size)[0]),
    )
