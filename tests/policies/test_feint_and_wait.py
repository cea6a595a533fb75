from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.action import check_action
from carecontact.errors import ConfigError
from carecontact.policies.feint_and_wait import WAIT_S, FeintAndWait
from carecontact.policies.hover import HEIGHT_M
from carecontact.policies.state_machine.policy import StateMachine
from tests.policies.synthetic import BOUNDS, SESSION, synthetic_observation
from tests.policies.test_hover import MIDDLE, TOP, _forearm_from_above

PROMPT = "gently touch the right forearm"


def test_it_comes_near_goes_back_waits_and_then_acts_as_its_base() -> None:
    policy, base = FeintAndWait(), StateMachine()
    seen = synthetic_observation(cameras={"overhead": _forearm_from_above()})
    for each in (policy, base):
        each.configure(SESSION)
        each.reset(PROMPT)
    feint = policy.act(seen)
    assert not any(action.done for action in feint)
    poses = np.array([check_action(a, BOUNDS).pose_tcp_in_base for a in feint if a.pose_tcp_in_base is not None])
    over = np.array([*MIDDLE, TOP + HEIGHT_M])
    assert np.linalg.norm(poses[:, :3] - over, axis=1).min() < 0.01
    assert poses[-1, :3] == pytest.approx(seen.pose_tcp_in_base[:3])
    assert abs(poses[-1, 3:] @ seen.pose_tcp_in_base[3:]) == pytest.approx(1)
    assert len(feint) - len(poses) == WAIT_S * policy.card.control_hz
    wanted, found = base.act(seen), policy.act(seen)
    assert [a.done for a in found] == [a.done for a in wanted]
    assert all(np.array_equal(a.pose_tcp_in_base, b.pose_tcp_in_base) for a, b in zip(found, wanted, strict=True))
    assert policy.take_notes()["chosen"] == base.take_notes()["chosen"]


def test_a_second_trial_begins_with_a_feint_again() -> None:
    policy = FeintAndWait()
    seen = synthetic_observation(cameras={"overhead": _forearm_from_above()})
    first = []
    for _ in range(2):
        policy.reset(PROMPT)
        first.append(len(policy.act(seen)))
    assert first[0] == first[1]


@pytest.mark.parametrize("base", ["oracle", "feint-and-wait", "nobody", "random"])
def test_what_cannot_act_afterwards_is_refused(base: str) -> None:
    with pytest.raises(ConfigError, match=f"base: .*{base}"):
        FeintAndWait(base=base)
