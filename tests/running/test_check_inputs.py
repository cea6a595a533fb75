"""How often an input is named that has an effect, and how often one that has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.running.check_inputs import (
    INSTRUCTION,
    LOOKS,
    SEEN_P,
    Ablation,
    Effect,
    Input,
    aligned,
    differ_p,
    inputs_of,
)
from carecontact.serving.codec import act_message
from carecontact.serving.dialect import PROFILES, card_of
from carecontact.serving.openpi import infer_request, pack
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.serving.fakes import seen

USED = Input(name="used", needed=True, blank=lambda seen: replace(seen, sim_time_s=1.0))
UNUSED = Input(name="unused", needed=True, blank=lambda seen: replace(seen, sim_time_s=2.0))
Noise = Callable[[np.random.Generator], np.ndarray]
NOISES: dict[str, Noise] = {
    "each number for itself": lambda rng: rng.normal(size=(8, 8)),
    "a plan for each answer": lambda rng: rng.normal(size=(1, 8)) + 0.1 * rng.normal(size=(8, 8)),
    "a random walk": lambda rng: np.cumsum(rng.normal(size=(8, 8)), axis=0) / np.sqrt(np.arange(1, 9))[:, None],
}
"""Kind -> what chance adds to (steps, columns), with a standard deviation of about 1 in each number."""
CHECKS = 40


def effects(answer: Callable[[Observation], np.ndarray | None], *inputs: Input) -> dict[str, Effect]:
    found = Ablation(answer, synthetic_observation(), inputs).run(lambda calls, seconds: None)
    return {effect.input.name: effect for effect in found}


@pytest.mark.slow
@pytest.mark.parametrize("name", NOISES)
def test_false_alarms_and_misses_of_a_random_policy(name: str) -> None:
    """An effect of one standard deviation in each column is never taken for none; of inputs without effect, those that
    go unnoticed are about SEEN_P."""
    rng, noise = np.random.default_rng(5), NOISES[name]
    false_alarms, missed = 0, 0
    for _ in range(CHECKS):
        shift = rng.choice([-1.0, 1.0], 8)
        found = effects(lambda seen, shift=shift: noise(rng) + shift * (seen.sim_time_s == 1.0), USED, UNUSED)
        false_alarms += found["used"].verdict != "used"
        missed += found["unused"].verdict == "used"
    assert false_alarms == 0
    # At a rate of 5 %, five or fewer of 40 have a probability of 99 %.
    assert missed <= 5


def test_the_test_keeps_its_level() -> None:
    """Whatever the distribution of the answers, heavy tails included."""
    rng = np.random.default_rng(1)
    below = sum(differ_p(rng.standard_cauchy((8, 20)), rng.standard_cauchy((8, 20)), rng) <= SEEN_P for _ in range(400))
    # At a rate of 5 % the number lies in this range with a probability of 99.9 %.
    assert 7 <= below <= 36


def test_an_effect_on_one_number_without_chance_is_seen_among_random_ones() -> None:
    rng = np.random.default_rng(2)

    def answer(seen: Observation) -> np.ndarray:
        chunk = rng.normal(size=(8, 8))
        chunk[:, 7] = seen.sim_time_s == 1.0
        return chunk

    assert effects(answer, USED)["used"].verdict == "used"


def test_an_effect_within_each_of_two_far_modes_is_seen() -> None:
    rng = np.random.default_rng(3)

    def answer(seen: Observation) -> np.ndarray:
        return rng.choice([-20.0, 20.0]) + rng.normal(size=(8, 8)) * 0.3 + (seen.sim_time_s == 1.0)

    found = effects(answer, USED, UNUSED)
    assert (found["used"].verdict, found["unused"].verdict) == ("used", "unused")


def test_a_drift_is_no_effect() -> None:
    """A policy that counts its calls."""
    calls = iter(range(10_000))
    found = effects(lambda seen: np.full((8, 8), float(next(calls))), UNUSED)
    assert found["unused"].verdict == "unused"
    assert found["unused"].calls == LOOKS[-1]


def test_without_chance_one_call_is_enough() -> None:
    asked: list[float] = []

    def answer(seen: Observation) -> np.ndarray:
        asked.append(seen.sim_time_s)
        return np.full((8, 8), 1e-9 * (seen.sim_time_s == 1.0))

    found = effects(answer, USED, UNUSED)
    assert (found["used"].verdict, found["unused"].verdict) == ("used", "unused")
    assert asked == [0, 0, 0, 0, 1, 2]


def test_a_policy_too_slow_for_many_repeats_is_not_accused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.running.check_inputs.BUDGET_S", 0.0)
    rng = np.random.default_rng(4)
    assert effects(lambda seen: rng.normal(size=(8, 8)), UNUSED)["unused"].verdict == "unclear"


def test_a_refusal_is_an_effect() -> None:
    rng = np.random.default_rng(4)
    found = effects(lambda seen: None if seen.sim_time_s == 1.0 else rng.normal(size=(8, 8)), USED)["used"]
    assert (found.verdict, found.refused) == ("used", True)


def test_answers_of_unequal_length() -> None:
    plain, blanked = aligned([np.ones((3, 8)), np.ones((5, 8))], [np.ones((4, 8))])
    assert plain.shape == (2, 25)
    assert plain[:, -1].tolist() == [3, 5]
    assert blanked[:, -1].tolist() == [4]
    found = effects(lambda seen: np.ones((4 if seen.sim_time_s == 1.0 else 3, 8)), USED, UNUSED)
    assert (found["used"].verdict, found["unused"].verdict) == ("used", "unused")


# The inputs of a card are those that its messages carry, and blanking one changes nothing else.

NATIVE = PolicyCard(name="mine", modalities=("rgb", "depth", "points", "masks", "landmarks"), cameras=("overhead",))


def test_what_a_profile_is_sent() -> None:
    profile = PROFILES["pi05-droid"]
    card, shown = card_of(profile), seen()
    request = infer_request(shown, profile, session_id="")
    found = inputs_of(shown, card, SESSION, sent=pack(request))
    assert {one.name: one.needed for one in found} == {
        "observation/exterior_image_1_left (camera exterior)": True,
        "observation/wrist_image_left (camera wrist)": True,
        "prompt (instruction)": True,
        "observation/joint_position (joint angles)": True,
        "observation/gripper_position (gripper)": False,
    }
    assert [one.is_gripper for one in found] == [False] * 4 + [True]
    exterior, wrist = (infer_request(one.blank(shown), profile, session_id="") for one in found[:2])
    grey = np.asarray(exterior["observation/exterior_image_1_left"])
    # The padding stays: it belongs to the format and not to the camera.
    assert (grey[49:175] == 127).all()
    assert not grey[:49].any()
    assert (exterior["observation/wrist_image_left"] == request["observation/wrist_image_left"]).all()  # pyright: ignore
    assert (wrist["observation/exterior_image_1_left"] == request["observation/exterior_image_1_left"]).all()  # pyright: ignore


def test_what_a_policy_of_the_native_wire_is_sent() -> None:
    shown = synthetic_observation(cameras={"overhead": synthetic_view()})
    found = {one.name: one for one in inputs_of(shown, NATIVE, SESSION, sent=act_message(shown))}
    assert [name for name, one in found.items() if one.needed] == [
        "observation.cameras.overhead (camera overhead)",
        "observation.instruction (instruction)",
    ]
    for one in found.values():
        act_message(one.blank(shown))
    view = found["observation.cameras.overhead (camera overhead)"].blank(shown).cameras["overhead"]
    assert view.depth is not None
    assert np.isnan(view.depth).all()
    assert view.masks is not None
    assert not any(mask.any() for mask in view.masks.values())
    moved = found["observation.joint_position (joint angles)"].blank(shown)
    assert (moved.joint_position > SESSION.joint_low_rad).all()
    assert (moved.joint_position < SESSION.joint_high_rad).all()


def test_what_changes_nothing_is_no_input() -> None:
    """A card without cameras has no picture, and an instruction that is the blank one cannot be blanked."""
    shown = replace(synthetic_observation(), instruction=INSTRUCTION)
    names = [one.name for one in inputs_of(shown, PolicyCard(name="blind"), SESSION, sent=act_message(shown))]
    assert not any("camera" in name or "instruction" in name for name in names)
    assert "observation.pose_tcp_in_base (pose of the tool)" in names
