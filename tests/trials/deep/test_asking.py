"""Requests one after another, with policies that take one reset for each connection or refuse a request."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest

from carecontact.contract.action import Action
from carecontact.contract.observation import Observation
from carecontact.errors import PolicyError
from carecontact.hosting.client import ActReply
from carecontact.hosting.conversation import PolicyConversation
from carecontact.trials.deep.asking import Asking
from tests.policies.synthetic import SESSION, synthetic_observation


@dataclass
class Conversation:
    """In place of a PolicyConversation."""

    resets: int = 0
    most_resets: int = 99
    calls: list[str] = field(default_factory=list)

    def start(self) -> None:
        self.calls.append("start")

    def reset(self, instruction: str, session: Any) -> None:
        self.resets += 1
        if self.resets > self.most_resets:
            raise PolicyError("garbage", "one reset is enough")

    def act(self, observation: Observation) -> ActReply:
        if observation.instruction == "refuse":
            raise PolicyError("exception", "no")
        return ActReply(actions=[Action(gripper=0.5)], sent=b"", sent_sha256=b"")

    def close(self) -> None:
        self.calls.append("close")


def asking(*conversations: Conversation) -> tuple[Asking, list[Any], list[float]]:
    listened: list[Any] = []
    took_s: list[float] = []
    first, *others = conversations
    left = iter(others)
    made = Asking(
        cast(PolicyConversation, first), SESSION, check=lambda action: None, listen=listened.append,
        reopen=lambda: cast(PolicyConversation, next(left)), took_s=took_s,
    )  # fmt: skip
    return made, listened, took_s


def test_a_policy_that_takes_one_reset_is_connected_again() -> None:
    conversations = [Conversation(most_resets=1) for _ in range(3)]
    made, listened, took_s = asking(*conversations)
    with made:
        for _ in range(3):
            assert made.ask(synthetic_observation(), may_refuse=False) is not None
    assert listened == conversations[1:]
    # The caller closes the first one, which is its own.
    assert [c.calls for c in conversations] == [[], ["start", "close"], ["start", "close"]]
    assert len(took_s) == 3


def test_a_refusal_connects_again_and_one_that_may_not_be_is_raised() -> None:
    refused = replace(synthetic_observation(), instruction="refuse")
    made, listened, took_s = asking(Conversation(), Conversation())
    with made:
        assert made.ask(refused, may_refuse=True) is None
        assert len(listened) == 1
        assert made.ask(synthetic_observation(), may_refuse=True) is not None
        with pytest.raises(PolicyError, match="no"):
            made.ask(refused, may_refuse=False)
    assert len(took_s) == 1
