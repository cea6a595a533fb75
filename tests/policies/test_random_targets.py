from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carecontact.contract.action import check_action
from carecontact.errors import ContractError
from carecontact.policies.random_targets import RandomTargets
from tests.policies.synthetic import BOUNDS, SESSION, synthetic_observation, synthetic_view


def targets(instruction: str, *, seed: int = 0) -> np.ndarray:
    policy = RandomTargets()
    policy.configure(SESSION)
    policy.reset(instruction)
    actions = policy.act(synthetic_observation(cameras={"overhead": synthetic_view(seed=seed)}))
    assert not any(action.done for action in actions)
    return np.array([check_action(action, BOUNDS).pose_tcp_in_base for action in actions])


def test_fills_the_trial_and_the_workspace() -> None:
    found = targets("touch")
    assert len(found) / RandomTargets.card.control_hz == SESSION.time_limit_s
    low, high = np.array(BOUNDS.workspace_low_m), np.array(BOUNDS.workspace_high_m)
    assert ((found[:, :3].max(0) - found[:, :3].min(0)) > 0.8 * (high - low)).all()


def test_same_words_and_image_same_targets_and_others_others() -> None:
    first = targets("touch")
    np.testing.assert_array_equal(first, targets("touch"))
    assert (first != targets("scrub")).any()
    assert (first != targets("touch", seed=1)).any()


def test_needs_what_its_card_asks_for() -> None:
    policy = RandomTargets()
    policy.configure(SESSION)
    blind = dataclasses.replace(synthetic_view(), depth=None)
    with pytest.raises(ContractError, match="depth image"):
        policy.act(synthetic_observation(cameras={"overhead": blind}))
