from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action_spaces import check_action
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.robot import ActionBounds
from carecontact.policies.replay import Donor, Replay, ReplayRegistered, read_donors
from carecontact.protocol.gates import Task
from carecontact.protocol.load import load_protocol
from tests.policies.synthetic import synthetic_observation, synthetic_view
from tests.protocol.foamy import FOAMY

PROTOCOL = load_protocol("bathing-v3")


@pytest.mark.parametrize("task", PROTOCOL.tasks, ids=lambda task: task.id)
def test_every_task_was_recorded_and_its_actions_are_allowed(task) -> None:
    limits = PROTOCOL.impedance
    bounds = ActionBounds(
        workspace_low_m=limits.workspace_low_m,
        workspace_high_m=limits.workspace_high_m,
        translational_stiffness=limits.translational_bounds,
        rotational_stiffness=limits.rotational_bounds,
    )
    policy = Replay()
    policy.reset(task.prompt)
    actions = [check_action(action, bounds) for action in policy.act(synthetic_observation())]
    poses = np.array([a.pose_tcp_in_base for a in actions if a.pose_tcp_in_base is not None])
    # It goes somewhere and comes back within the time limit.
    assert np.ptp(poses[:, :3], axis=0).max() > 0.1
    assert len(actions) / policy.card.control_hz < PROTOCOL.phases.time_limit_s
    assert [a.done for a in actions] == [False] * (len(actions) - 1) + [True]


def test_tasks_differ() -> None:
    assert len({donor.actions.tobytes() for donor in read_donors().values()}) == len(PROTOCOL.tasks)


@pytest.mark.parametrize(("name", "protocol"), [("actions", "bathing-v3"), ("bathing-wide-L2", "bathing-wide-v2")])
def test_a_shipped_donor_has_a_name_and_every_task(name: str, protocol: str) -> None:
    rules = load_protocol(protocol)
    assert read_donors(Path(name)).keys() == {rules.task(task.id).prompt for task in rules.tasks}


def test_an_unknown_instruction_lists_what_there_is() -> None:
    with pytest.raises(ContractError, match="gently touch the right forearm"):
        Replay().reset("dance")
    with pytest.raises(ContractError, match="left forearm"):
        Replay().reset("gently touch the left forearm")


@pytest.mark.parametrize("task", FOAMY.tasks, ids=lambda task: task.id)
def test_the_instruction_that_names_foam_gets_the_actions_of_the_plain_one(task: Task) -> None:
    policies = Replay(), Replay()
    for policy, prompt in zip(policies, (task.prompt, FOAMY.task(task.id).prompt), strict=True):
        policy.reset(prompt)
    np.testing.assert_array_equal(policies[0]._donor.actions, policies[1]._donor.actions)


def test_registered_actions_keep_their_place_before_the_camera() -> None:
    """A robot that stands a quarter turn and half a metre elsewhere under the same camera makes the same way over the
    person; where nothing moved, both baselines make the same one."""
    prompt, tip = PROTOCOL.tasks[0].prompt, np.array([0.0, 0.0, 0.1])
    donor = read_donors()[prompt]
    elsewhere = pose_matrix(np.array([0.1, -0.5, 0.05]), np.array([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]))
    policy = ReplayRegistered()
    policy.reset(prompt)

    def in_picture(pose_camera: np.ndarray) -> np.ndarray:
        view = replace(synthetic_view(), pose_camera_in_base=pose_camera)
        actions = policy.act(synthetic_observation(cameras={"overhead": view}))
        poses = np.array([pose_matrix(a.pose_tcp_in_base[:3], a.pose_tcp_in_base[3:]) for a in actions])
        seen = np.linalg.inv(pose_camera) @ poses
        return seen[:, :3, :3] @ tip + seen[:, :3, 3]

    here, there = donor.pose_camera_in_base, elsewhere @ donor.pose_camera_in_base
    assert np.allclose(in_picture(here), in_picture(there), atol=1e-9)
    unmoved = donor.seen_from(donor.pose_camera_in_base)
    assert np.allclose(unmoved.actions[:, :3], donor.actions[:, :3], atol=1e-12)
    assert np.allclose(abs((unmoved.actions[:, 3:7] * donor.actions[:, 3:7]).sum(1)), 1, atol=1e-6)


def test_what_an_action_left_alone_stays_so() -> None:
    rows = np.full((2, 9), np.nan)
    rows[0, :7] = [0.4, 0, 0.3, 0, 1, 0, 0]
    moved = Donor(actions=rows, pose_camera_in_base=np.eye(4)).seen_from(
        pose_matrix(np.ones(3), np.array([1.0, 0, 0, 0]))
    )
    assert moved.actions[0, :3] == pytest.approx([1.4, 1.0, 1.3])
    assert np.isnan(moved.actions[1]).all()
    assert [action.pose_tcp_in_base is None for action in moved.chunk()] == [False, True]


def test_a_file_that_is_no_donor_is_named(tmp_path: Path) -> None:
    (tmp_path / "x.npz").write_bytes(b"no")
    with pytest.raises(ConfigError, match=r"x\.npz: not a file of tools/record_replay\.py"):
        Replay(donor=tmp_path / "x.npz")
