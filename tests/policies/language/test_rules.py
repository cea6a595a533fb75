from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.errors import ContractError, LanguageError
from carecontact.policies.language.backend import Intent, Option
from carecontact.policies.language.rules import ACTIONS, MANNERS, Rules
from carecontact.protocols import load_protocol
from carecontact.regions import REGIONS, STANDARD_REGIONS


@pytest.mark.parametrize(
    ("instruction", "expected"),
    [
        ("gently touch the right forearm", ("touch", "forearm", "right", "gentle")),
        ("push the right forearm", ("push", "forearm", "right", "none")),
        ("Wash the RIGHT lower arm.", ("scrub", "forearm", "right", "none")),
        ("please wipe the left upper-arm firmly", ("scrub", "upper_arm", "left", "firm")),
        ("rest your hand on the belly, softly", ("touch", "abdomen", "none", "gentle")),
        ("push  aside the right\tforearm", ("push", "forearm", "right", "none")),
    ],
)
def test_known_instructions(instruction: str, expected: tuple[str, str, str, str]) -> None:
    intent = Rules().parse(instruction)
    assert (intent.action, intent.region, intent.side, intent.manner) == expected


def test_every_prompt_of_the_protocol_means_its_task() -> None:
    for task in load_protocol().tasks:
        intent = Rules().parse(task.prompt)
        assert (intent.action, intent.region) == (task.action, task.region)
        assert intent.side == ("none" if task.region == "abdomen" else "right")


@given(
    action=st.sampled_from([(a, w) for a, words in ACTIONS.items() for w in words]),
    region=st.sampled_from([(r, w) for r in STANDARD_REGIONS for w in REGIONS[r].words]),
    manner=st.sampled_from([("none", ""), *((m, w) for m, words in MANNERS.items() for w in words)]),
)
def test_every_synonym_is_understood(action: tuple[str, str], region: tuple[str, str], manner: tuple[str, str]) -> None:
    side = "" if region[0] == "abdomen" else "left"
    intent = Rules().parse(f"{manner[1]} {action[1]} the {side} {region[1]}")
    assert (intent.action, intent.region, intent.manner) == (action[0], region[0], manner[0])


@pytest.mark.parametrize(
    ("instruction", "word"),
    [
        ("touch the forearm", "which forearm"),
        ("touch the right arm", "no region"),
        ("caress the right forearm", "no action"),
        ("touch and scrub the right forearm", "more than one action"),
        ("touch the abdomen and the right forearm", "more than one region"),
        ("touch the right or left forearm", "more than one side"),
        ("gently but firmly scrub the abdomen", "more than one manner"),
        ("do not touch the right forearm", "negation"),
        ("don’t touch the abdomen", "negation"),
        ("touch the right abdomen", "no right side"),
        ("", "no action"),
    ],
)
def test_refuses_what_is_ambiguous(instruction: str, word: str) -> None:
    with pytest.raises(LanguageError, match=word):
        Rules().parse(instruction)


def intent(action: str = "touch", manner: str = "none") -> Intent:
    return Intent.model_validate({"action": action, "region": "forearm", "side": "right", "manner": manner})


def option(**changes: object) -> Option:
    base = {"primitive": "touch", "approach": "above", "key_point": 0.5, "depth_m": 0.015, "speed_m_s": 0.04}
    return Option(**{**base, **changes})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(("manner", "depth"), [("gentle", 0.010), ("none", 0.015), ("firm", 0.020)])
def test_manner_picks_the_depth(manner: str, depth: float) -> None:
    options = [option(depth_m=d) for d in (0.020, 0.010, 0.015)]
    assert options[Rules().choose(intent(manner=manner), options)].depth_m == depth


def test_push_takes_the_longest_lever_on_the_near_side() -> None:
    options = [
        option(),
        option(primitive="push", approach="far_side", key_point=0.9),
        option(primitive="push", approach="near_side", key_point=0.5),
        option(primitive="push", approach="near_side", key_point=0.7),
    ]
    assert Rules().choose(intent("push"), options) == 3


def test_the_middle_wins_and_ties_go_to_the_first() -> None:
    options = [option(key_point=0.2), option(key_point=0.5), option(key_point=0.5)]
    assert Rules().choose(intent(), options) == 1


def test_no_fitting_option_is_an_error() -> None:
    with pytest.raises(ContractError, match="none of 1 options is a scrub"):
        Rules().choose(intent("scrub"), [option()])
