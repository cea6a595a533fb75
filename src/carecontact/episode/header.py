"""The header of a trial's recording: what was run, on what, and how it ended."""

from __future__ import annotations

from typing import Any

from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import drawn_facts
from carecontact.episode.ended import Ended
from carecontact.kernel.found import sha256 as kernel_sha256
from carecontact.recording.schema import SEGMENTS, Header
from carecontact.recording.versions import DECLARED, trial_versions
from carecontact.sim.simulation import Settled, Simulation


def header_of(
    spec: TrialSpec,
    simulation: Simulation,
    settled: Settled,
    ended: Ended,
    *,
    model_sha256: str,
    card: dict[str, Any] | None,
    control: str | None,
    privileged: bool = False,
) -> Header:
    """Return the header of a recording.

    ``card``, ``control``: None if the policy never showed its card. ``privileged``: whether the policy was given the
    simulation.
    """
    warnings = simulation.solver_warnings()
    if simulation.normal_sum_truncated:
        warnings.append("normal-force sensor full: normal sums are too small")
    return Header(
        spec=spec,
        ended=ended.reason,
        failure=ended.failure,
        card=card,
        control=control,
        privileged=privileged,
        embodiment=simulation.robot.id,
        comfort_arm_deg=settled.comfort_arm_deg,
        segments=list(SEGMENTS),
        regions=list(spec.protocol.regions),
        human_joints=simulation.joint_names,
        pose_base_in_world=simulation.pose_base_in_world.tolist(),
        identity=DECLARED,
        versions=trial_versions(spec.protocol),
        sha256={
            "model": model_sha256,
            "body": simulation.scene.body.sha256,
            "robot": simulation.robot.source.sha256,
            "kernel": kernel_sha256(),
        },
        solver_warnings=warnings,
        drawn=drawn_facts(simulation.scene.protocol, simulation.scene.place)
        if spec.protocol.variation.draws_models
        else {},
    )
