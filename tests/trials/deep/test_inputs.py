"""The inputs of a card are those that its messages carry, and blanking one changes nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carecontact.contract.policy import PolicyCard
from carecontact.hosting.dialects.packing_openpi import pack
from carecontact.hosting.dialects.profiles import PROFILES, card_of
from carecontact.hosting.dialects.requests import infer_request
from carecontact.hosting.wire.messages import act_message
from carecontact.trials.deep.inputs import INSTRUCTION, inputs_of
from tests.hosting.dialects.talking import seen
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view

NATIVE = PolicyCard(name="mine", modalities=("rgb", "depth", "points", "masks", "landmarks"), cameras=("overhead",))


def test_what_a_profile_is_sent() -> None:
    profile = PROFILES["pi05-droid"]
    card, shown = card_of(profile, dialect="openpi"), seen()
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
        "observation.cameras.overhead (camera overhead)", "observation.instruction (instruction)",
    ]  # fmt: skip
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
