"""The declared versions of world and kernel stand for numbers: a change that moves them has to raise a version.

A press on the forearm of the default protocol, without a camera. Constants of the compiled model agree to nine digits
on every machine. Settling and contact amplify the last bits of linear algebra: between kernels of OpenBLAS for three
generations of processors, the settled joints differed by 2e-5 rad at most and the forces of the press by 6e-6, so that
these numbers are held to RELATIVE. After a change on purpose, raise ``recording.versions.DECLARED`` and run ``python -m
tests.golden.test_declared`` from the repository's root.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.provenance import DECLARED

EXPECTED = Path(__file__).with_name("declared.json")
RELATIVE = 5e-4
MODEL = ("body_mass", "body_inertia", "qpos0", "geom_size", "dof_damping", "jnt_range", "actuator_gainprm")
"""Fields of the compiled model of which the sum of squares is held."""


def found() -> dict[str, Any]:
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="golden")
    with Episode(spec, card=PolicyCard(name="golden", cameras=(), control_hz=20)) as episode:
        first, simulation = episode.reset(), episode.simulation
        model = {name: float(np.square(getattr(simulation.model, name)).sum()) for name in MODEL}
        episode.step(Action(), observe=False)
        column = list(spec.protocol.regions).index("forearm")
        region = episode.log.arrays()["scorer/region_pose_in_world"][-1][column, :3].astype(float)
        base = np.array(simulation.pose_base_in_world)
        goal = matrix_from_quat(base[3:]).T @ (region - base[:3])
        for above_m in (0.10, 0.05, 0.0, -0.01):
            place = goal + [0.0, 0.0, simulation.scene.region_size_m[column][2] + above_m]
            pose = np.concatenate([place, first.pose_tcp_in_base[3:]])
            for _ in range(20):
                episode.step(Action(pose_tcp_in_base=pose), observe=False)
        episode.step(Action(done=True), observe=False)
        recording = episode.finish()
    force = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"], axis=2).max(axis=1)
    onset = int(np.flatnonzero(force > 0.5)[0])
    return {
        "declared": {name: DECLARED[name] for name in ("world", "kernel")},
        "model": model,
        "settled": recording["scorer/human_joint_settled"].tolist(),
        "wrist": recording["scorer/wrist_settled_in_world"].tolist(),
        "onset_step": onset,
        "force_n": [float(force[onset + steps]) for steps in (10, 50, 100, 200)],
        "indentation_mm": float(1000 * recording["scorer/indentation_m"].max()),
    }


def test_the_declared_world_and_kernel_are_what_they_were() -> None:
    expected, now = json.loads(EXPECTED.read_text()), found()
    assert now["declared"] == expected["declared"], "run this file after a version was raised"
    assert now["model"] == pytest.approx(expected["model"], rel=1e-9)
    assert abs(now["onset_step"] - expected["onset_step"]) <= 1
    for name in ("settled", "wrist", "force_n", "indentation_mm"):
        assert now[name] == pytest.approx(expected[name], rel=RELATIVE, abs=1e-4), name


if __name__ == "__main__":
    EXPECTED.write_text(json.dumps(found(), indent=1) + "\n")
