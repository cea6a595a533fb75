from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import ConfigError
from carecontact.interface.action_spaces import check_action
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.robot import Session
from carecontact.policies import mean_person
from carecontact.policies.mean_person import MeanPersonPolicy, geometry_in_base, read_person
from carecontact.policies.replay import read_donors
from carecontact.protocol.load import load_protocol
from tests.policies.synthetic import BOUNDS, SESSION, synthetic_observation, synthetic_view

PROTOCOL = load_protocol("bathing-v3")
CAMERA = read_donors()[PROTOCOL.tasks[0].prompt].pose_camera_in_base
"""As the overhead camera stands to the robot in the protocols of which the mean was taken."""


def _session() -> Session:
    limits = PROTOCOL.impedance
    low, high = limits.workspace_low_m, limits.workspace_high_m
    return replace(SESSION, action_bounds=replace(BOUNDS, workspace_low_m=low, workspace_high_m=high))


def _act(pose_camera: np.ndarray, prompt: str) -> np.ndarray:
    policy, session = MeanPersonPolicy(), _session()
    policy.configure(session)
    policy.reset(prompt)
    view = replace(synthetic_view(), pose_camera_in_base=pose_camera)
    actions = policy.act(synthetic_observation(cameras={"overhead": view}))
    assert actions[-1].done
    return np.array(
        [check_action(a, session.action_bounds).pose_tcp_in_base for a in actions if a.pose_tcp_in_base is not None]
    )


@pytest.mark.parametrize("task", PROTOCOL.tasks, ids=lambda task: task.id)
def test_it_has_a_motion_for_every_task_that_comes_down_to_the_mean_skin(task) -> None:
    poses = _act(CAMERA, task.prompt)
    skin = geometry_in_base(task.region, read_person(None).regions[task.region], CAMERA)
    assert poses[:, 2].min() < skin.centre_m[2] + 0.01
    lowest = poses[poses[:, 2].argmin(), :2]
    assert np.linalg.norm(lowest - skin.centre_m[:2]) < 0.15


def test_the_person_moves_with_the_camera() -> None:
    mean = read_person(None).regions["forearm"]
    moved = pose_matrix(np.array([0.05, 0.02, 0.01]), np.array([1.0, 0, 0, 0])) @ CAMERA
    before, after = (geometry_in_base("forearm", mean, pose) for pose in (CAMERA, moved))
    assert after.centre_m - before.centre_m == pytest.approx([0.05, 0.02, 0.01])
    assert after.axis == pytest.approx(before.axis)
    assert after.support_height_m == pytest.approx(before.support_height_m + 0.01)


def test_out_of_reach_it_ends_without_moving() -> None:
    far = pose_matrix(np.array([3.0, 0, 0]), np.array([1.0, 0, 0, 0])) @ CAMERA
    assert len(_act(far, PROTOCOL.tasks[0].prompt)) == 0


def test_where_no_motion_of_the_task_is_in_reach_it_ends_without_moving(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some motion is, but none that pushes."""
    every = mean_person.candidates
    monkeypatch.setattr(
        mean_person, "candidates", lambda *a, **k: [c for c in every(*a, **k) if c.option.primitive != "push"]
    )
    push = next(task for task in PROTOCOL.tasks if task.action == "push")
    assert len(_act(CAMERA, push.prompt)) == 0


def test_another_file_is_read_and_a_wrong_one_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(read_person(None).model_dump_json())
    assert read_person(path) == read_person(None) == read_person(Path("person")), "a shipped one has a name"
    path.write_text("{}")
    with pytest.raises(ConfigError, match=r"mine\.json: made_by"):
        read_person(path)
    with pytest.raises(ConfigError, match=r"valid: bathing-wide-L1, .*, or a file that tools/mean_person\.py wrote"):
        read_person(tmp_path / "none.json")


@pytest.mark.parametrize("level", ["L1", "L2"])
def test_the_exams_mean_is_shipped_by_name_and_is_not_the_other_protocols(level: str) -> None:
    person = read_person(Path(f"bathing-wide-{level}"))
    assert person.regions.keys() == {task.region for task in PROTOCOL.tasks}
    assert person.protocol.endswith(level)
    assert person.regions != read_person(None).regions
