from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.action import check_action
from carecontact.contract.session import ActionBounds
from carecontact.errors import ContractError
from carecontact.policies.replay.policy import Replay, recorded_actions
from carecontact.protocols import load_protocol
from tests.policies.synthetic import synthetic_observation

PROTOCOL = load_protocol()


@pytest.mark.parametrize("task", PROTOCOL.tasks, ids=lambda task: task.id)
def test_every_task_was_recorded_and_its_actions_are_allowed(task) -> None:
    limits = PROTOCOL.impedance
    bounds = ActionBounds(
        workspace_low_m=limits.workspace_low_m, workspace_high_m=limits.workspace_high_m,
        translational_stiffness=limits.translational_bounds, rotational_stiffness=limits.rotational_bounds,
    )  # fmt: skip
    policy = Replay()
    policy.reset(task.prompt)
    actions = [check_action(action, bounds) for action in policy.act(synthetic_observation())]
    poses = np.array([a.pose_tcp_in_base for a in actions if a.pose_tcp_in_base is not None])
    # It goes somewhere and comes back within the time limit.
    assert np.ptp(poses[:, :3], axis=0).max() > 0.1
    assert len(actions) / policy.card.control_hz < PROTOCOL.phases.time_limit_s
    assert [a.done for a in actions] == [False] * (len(actions) - 1) + [True]


def test_tasks_differ() -> None:
    assert len({rows.tobytes() for rows in recorded_actions().values()}) == len(PROTOCOL.tasks)


def test_an_unknown_instruction_lists_what_there_is() -> None:
    with pytest.raises(ContractError, match="gently touch the right forearm"):
        Replay().reset("dance")
