from __future__ import annotations

import re

import pytest

from carecontact.contract.action import Action
from carecontact.recording.remedies import REMEDIES, remedies
from tests.policies.synthetic import synthetic_observation


def test_a_refusal_has_its_remedy_and_other_failures_none() -> None:
    message = "policy 'x' failed at act: actions[0].pose_tcp_in_base: expected finite numbers, got [nan]"
    assert remedies(message) == ["Look for a division by 0 or an unset value in the policy's output."]
    assert remedies(f"{message}, which looks like nothing that was ever set") == []
    assert remedies("policy 'x' failed at act: its process was killed by SIGKILL without an answer") == []


@pytest.mark.parametrize(
    ("said", "may_help"),
    [
        ("KeyError: 'wrist'", "The card's cameras"),
        ("TypeError: 'NoneType' object is not subscriptable", "landmarks_in_base needs depth"),
        ("TypeError: 'Observation' object is not subscriptable", r"observation\.cameras"),
        ("TypeError: Action.__init__() got an unexpected keyword argument 'pose'", "pose_tcp_in_base"),
        ("TypeError: Mine.reset() takes 1 positional argument but 2 were given", r"def reset\(self, instruction\)"),
        ("expected an Action or a list of Actions, got coroutine <coroutine object", "not async def act"),
        ("InvalidMessage: did not receive a valid HTTP response", "no WebSocket server"),
    ],
)
def test_common_mistakes_in_a_policys_own_code_have_one(said: str, may_help: str) -> None:
    (remedy,) = remedies(f"policy 'x' failed at act: {said}")
    assert re.search(may_help, remedy)


def test_the_words_of_python_are_what_this_python_says() -> None:
    """The parts of REMEDIES are Python's own words, which another release may change."""
    observation, action, nothing = synthetic_observation(), Action, [None]
    for fault, part in (
        (lambda: observation["image"], "'Observation' object is not subscriptable"),
        (lambda: action(pose=1), "Action.__init__() got an unexpected keyword argument"),
        (lambda: nothing[0][0], "'NoneType' object is not subscriptable"),
    ):
        with pytest.raises(TypeError) as raised:
            fault()
        assert part in str(raised.value)
        assert part in REMEDIES
