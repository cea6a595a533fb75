from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from carecontact.contract.action import Action
from carecontact.contract.observation import MODALITIES, Observation
from carecontact.contract.policy import CAMERAS, Policy, PolicyCard, Session
from carecontact.errors import ContractError


def test_a_card_may_ask_for_everything() -> None:
    card = PolicyCard(name="all", modalities=MODALITIES, cameras=CAMERAS, control_hz=50)
    assert (card.modalities, card.cameras) == (MODALITIES, CAMERAS)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"name": ""}, "name is empty"),
        ({"action_space": "joint_position"}, "action_space 'joint_position'; valid: cartesian_pose"),
        ({"modalities": ("rgb", "force")}, r"modalities \['force'\]; valid: rgb, depth"),
        ({"modalities": "rgb"}, "modalities"),
        ({"cameras": ("overhead", "ceiling")}, r"cameras \['ceiling'\]; valid: overhead, bedside, exterior, wrist"),
        ({"cameras": "wrist"}, "cameras"),
        ({"control_hz": 0.99}, "control_hz 0.99; valid: 1 to 50"),
        ({"control_hz": 50.01}, "control_hz 50.01"),
        ({"control_hz": float("nan")}, "control_hz nan"),
    ],
)
def test_a_wrong_card_names_field_and_valid_values(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ContractError, match=message):
        PolicyCard(**{"name": "x", **wrong})


@pytest.mark.parametrize("rate", [1, 1.0, 50])
def test_rates_at_the_bounds_are_valid(rate: float) -> None:
    assert PolicyCard(name="x", control_hz=rate).control_hz == rate


def test_a_session_says_nothing_about_the_trial() -> None:
    assert {f.name for f in fields(Session)} == {
        "action_bounds", "joint_low_rad", "joint_high_rad", "camera_sizes_px", "time_limit_s",
    }  # fmt: skip


def test_a_policy_is_whatever_has_card_reset_and_act() -> None:
    class Whole:
        card = PolicyCard(name="x")

        def reset(self, instruction: str) -> None: ...

        def act(self, observation: Observation) -> Action:
            return Action()

    class NoReset:
        card = PolicyCard(name="x")
        act = Whole.act

    class NoCard:
        reset, act = Whole.reset, Whole.act

    assert isinstance(Whole(), Policy)
    assert not isinstance(NoReset(), Policy)
    assert not isinstance(NoCard(), Policy)
