from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from carecontact.contract.action import Action
from carecontact.contract.observation import MODALITIES, Observation
from carecontact.contract.policy import CAMERAS, Policy, PolicyCard
from carecontact.contract.session import Session
from carecontact.errors import ContractError


def test_a_card_may_ask_for_everything() -> None:
    card = PolicyCard(name="all", modalities=MODALITIES, cameras=CAMERAS, control_hz=50)
    assert (card.modalities, card.cameras) == (MODALITIES, CAMERAS)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"name": ""}, "PolicyCard.name: expected 1 to 200 printable characters, got ''"),
        ({"name": "n" * 201}, "PolicyCard.name: expected 1 to 200 printable characters, got 'nnn"),
        ({"name": "a\x1b[2J"}, r"PolicyCard.name: expected 1 to 200 printable characters, got 'a\\x1b\[2J'"),
        ({"name": 3}, "PolicyCard.name: expected 1 to 200 printable characters, got 3"),
        ({"language_backend": None}, "PolicyCard.language_backend: expected 1 to 200 printable characters, got None"),
        (
            {"action_space": "joints"},
            "action_space: expected one of cartesian_pose, droid_joint_velocity, joint_position, got 'joints'",
        ),
        (
            {"action_space": "joint_position"},
            "control: expected one of droid, droid-sim-evals, with the action space joint_position, "
            "got 'cartesian-impedance'",
        ),
        ({"control": "droid"}, "control: expected one of cartesian-impedance, with the action space cartesian_pose"),
        ({"modalities": ("rgb", "force")}, "modalities: expected a tuple of names out of rgb, depth, .* got 'force'"),
        ({"modalities": "rgb"}, "PolicyCard.modalities: expected a tuple of names .* got 'rgb'"),
        ({"cameras": ("ceiling",)}, "cameras: expected .* out of overhead, bedside, exterior, wrist, got 'ceiling'"),
        ({"cameras": "wrist"}, "PolicyCard.cameras: expected a tuple of names .* got 'wrist'"),
        ({"cameras": None}, "PolicyCard.cameras: expected a tuple of names .* got None"),
        ({"out_of_bounds": "clamp"}, "out_of_bounds: expected one of error, clip, got 'clamp'"),
        ({"control_hz": 0.99}, r"PolicyCard.control_hz: expected a number from 1 to 50 \[Hz\], got 0.99"),
        ({"control_hz": 50.01}, "got 50.01"),
        ({"control_hz": float("nan")}, "got nan"),
        ({"control_hz": "fast"}, "got 'fast'"),
        ({"control_hz": True}, "got True"),
        ({"arguments": {"a b": "1"}}, r"arguments: expected at most 64 names .* got \{'a b': '1'\}"),
        ({"arguments": {"steps": 3}}, r"arguments: .* printable texts .* got \{'steps': 3\}"),
        ({"arguments": {"steps": "3\n"}}, "arguments: .* printable texts"),
        ({"arguments": {"steps": "3" * 2001}}, "arguments: .* at most 2000 characters"),
        ({"arguments": {f"a{k}": "" for k in range(65)}}, "arguments: expected at most 64 names"),
        ({"arguments": "steps=3"}, "arguments: expected at most 64 names .* got 'steps=3'"),
        ({"environment": "TOKEN"}, "environment: expected at most 64 names of variables, got 'TOKEN'"),
        ({"environment": ("TOKEN=3",)}, "environment: .* got 'TOKEN=3'"),
    ],
)
def test_a_wrong_card_names_field_and_valid_values(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ContractError, match=message):
        PolicyCard(**{"name": "x", **wrong})


@pytest.mark.parametrize("rate", [1, 1.0, 50])
def test_rates_at_the_bounds_are_valid(rate: float) -> None:
    assert PolicyCard(name="x", control_hz=rate).control_hz == rate


def test_a_card_at_its_defaults_is_written_as_it_always_was() -> None:
    added = {"arguments", "environment", "out_of_bounds"}
    assert added.isdisjoint(PolicyCard(name="x").plain())
    assert PolicyCard(name="x", out_of_bounds="clip").plain()["out_of_bounds"] == "clip"


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
