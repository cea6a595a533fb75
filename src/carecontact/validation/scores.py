"""The scorer's C1, C5 and stroke of a scripted contact, so that the checks judge the numbers that are reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.errors import SceneError
from carecontact.recording.schema import SEGMENTS, Header, Recording
from carecontact.recording.versions import DECLARED
from carecontact.regions import REGIONS
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.c1_peak_force import peak_force
from carecontact.scoring.metrics.c5_force_stability import force_stability
from carecontact.scoring.progress import measure_episodes
from carecontact.sim.simulation import Samples, Simulation
from carecontact.validation.moves import Motion, Performance, perform
from carecontact.validation.subject import Subject

TOUCHED_M = 0.0002
"""Indentation above which the tissue counts as touched."""


@dataclass(frozen=True, kw_only=True)
class Scores:
    c1_n: float
    c1_filtered_n: float
    c5_n: float
    stroke_m: float
    beyond_measured: float
    """Share of the time in the tissue that was spent deeper than the reference measurements."""


def scores_of(simulation: Simulation, region: str, performance: Performance) -> Scores:
    """Return the scores of a contact: all NaN if the region was not touched; the filtered peak is NaN if the time step
    is too long for the filter.

    Raises SceneError if MuJoCo warned on the way.
    """
    dt, cutoff = simulation.model.opt.timestep, simulation.protocol.contact.peak_filter_hz
    warnings = simulation.solver_warnings()
    if warnings:
        raise SceneError(
            f"MuJoCo warned in a scripted contact at a time step of {1000 * dt:g} ms: {', '.join(warnings)}"
        )
    contact = find_contact(recording_of(simulation, region, performance.samples))
    spread = force_stability(contact)
    if spread is None or contact.reported != contact.target:
        return Scores(c1_n=np.nan, c1_filtered_n=np.nan, c5_n=np.nan, stroke_m=np.nan, beyond_measured=np.nan)
    # The scorer's filter needs a sample rate of more than twice its cutoff.
    peak = peak_force(contact) if 2 * cutoff * dt < 1 else None
    depth = performance.indentation_m[:, simulation.protocol.regions.index(region)]
    measured = simulation.scene.regions[region].tissue.measured_depth_m
    return Scores(
        c1_n=float(contact.force_in_window.max()), c5_n=spread,
        c1_filtered_n=np.nan if peak is None else peak.c1_peak_filtered_n,
        stroke_m=sum(episode.stroke_m for episode in measure_episodes(contact)),
        beyond_measured=float((depth > measured).sum() / max(1, (depth > TOUCHED_M).sum())),
    )  # fmt: skip


def motion_scores(subject: Subject, region: str, motion: Motion) -> Scores:
    simulation = subject.hovering(region)
    return scores_of(simulation, region, perform(simulation, region, motion))


def _with_task_on(protocol: Protocol, region: str) -> Protocol:
    """Return the protocol with a task on the region, which is added if there is none, because the scorer finds a
    trial's region by its task.
    """
    if any(task.region == region for task in protocol.tasks):
        return protocol
    task = protocol.tasks[0].model_copy(update={"id": "scripted", "region": region})
    contact = protocol.contact
    near = {region: list(REGIONS[region].neighbourhood), **contact.neighbourhood}
    return protocol.model_copy(
        update={"tasks": [*protocol.tasks, task], "contact": contact.model_copy(update={"neighbourhood": near})}
    )


def recording_of(simulation: Simulation, region: str, samples: Sequence[Samples]) -> Recording:
    """Return a recording of a scripted contact, with as much as the scorer reads."""
    protocol = _with_task_on(simulation.protocol, region)
    task_id = next(task.id for task in protocol.tasks if task.region == region)
    spec = TrialSpec(protocol=protocol, task_id=task_id, seed=0, policy="scripted")
    header = Header(
        spec=spec, ended="done", failure=None, card=None, embodiment="", comfort_arm_deg=None, segments=list(SEGMENTS),
        regions=list(protocol.regions), human_joints=simulation.joint_names,
        pose_base_in_world=simulation.pose_base_in_world.tolist(), identity=DECLARED, versions={}, sha256={},
        solver_warnings=[],
    )  # fmt: skip
    return Recording.trusted(
        header,
        {
            "scorer/time_s": np.concatenate([s.time_s for s in samples]),
            "scorer/force_human_from_robot_in_world": np.concatenate([s.force for s in samples]),
            "scorer/normal_force": np.concatenate([s.normal for s in samples]),
            "scorer/human_joint_position": np.concatenate([s.human_joint for s in samples]),
            "scorer/human_joint_range": simulation.joint_range,
            "scorer/human_joint_settled": samples[0].human_joint[0],
            "scorer/tcp_speed": np.concatenate([s.tcp_speed for s in samples]),
            "scorer/tcp_rotation_speed": np.concatenate([s.tcp_rotation_speed for s in samples]),
            "scorer/pose_tcp_in_world": np.concatenate([s.tcp_pose for s in samples]),
            "scorer/region_pose_in_world": np.concatenate([s.region_pose for s in samples]),
            "scorer/region_size_m": simulation.scene.region_size_m,
        },
    )


def force_norm(samples: Sequence[Samples], region_segment: str) -> np.ndarray:
    """Return the magnitude (n,) [N] of the robot's force on one segment at every step."""
    column = SEGMENTS.index(region_segment)
    return np.linalg.norm(np.concatenate([s.force[:, column] for s in samples]), axis=1)
