"""What a policy may see: an allow-list, so that a new field is a decision and not an accident."""

from __future__ import annotations

import re
from dataclasses import FrozenInstanceError, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carecontact
from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action import Action
from carecontact.interface.observation import MODALITIES, CameraView, Observation
from carecontact.interface.policy import CAMERAS, Policy, PolicyCard, PolicyRef
from carecontact.interface.robot import EMBODIMENTS, PANDA, Robot, Session
from carecontact.protocol.load import load_levels, load_protocol, shipped_protocols
from carecontact.world.robot import arrays_of

VISIBLE = {"instruction", "sim_time_s", "joint_position", "joint_velocity", "gripper_position", "pose_tcp_in_base"}
VISIBLE |= {"velocity_tcp_in_base", "cameras"}
VISIBLE_IN_A_CAMERA = set(
    "intrinsics pose_camera_in_base rgb depth points point_colors masks landmarks landmarks_in_base sim_time_s".split()
)


def view(**kwargs: np.ndarray) -> CameraView:
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), **kwargs)


def observation() -> Observation:
    return Observation(
        instruction="touch",
        sim_time_s=0.0,
        joint_position=np.zeros(7),
        joint_velocity=np.zeros(7),
        gripper_position=np.zeros(1),
        pose_tcp_in_base=np.array([0, 0, 0, 1.0, 0, 0, 0]),
    )


def test_nothing_but_the_allowed_fields() -> None:
    assert {f.name for f in fields(Observation)} == VISIBLE
    assert {f.name for f in fields(CameraView)} == VISIBLE_IN_A_CAMERA


def test_every_modality_is_a_field_that_is_absent_unless_given() -> None:
    assert set(MODALITIES) <= VISIBLE_IN_A_CAMERA
    assert [getattr(view(), m) for m in MODALITIES] == [None] * len(MODALITIES)


def test_observations_are_frozen_and_share_no_dictionary() -> None:
    first, second = observation(), observation()
    with pytest.raises(FrozenInstanceError):
        first.instruction = "push"  # pyright: ignore[reportAttributeAccessIssue]
    first.cameras["overhead"] = view()
    assert second.cameras == {}


NAMES_THE_PANDA = {
    "interface/robot.py": "describes it, and cites the file of DROID's robots from which gains come",
    "interface/action_spaces.py": "cites the same file for a limit",
    "sensing/builder.py": "cites what its measured speeds are derived from",
    "serving/cartesian.py": "cites a file of LIBERO's robots",
    "serving/openpi.py": "DROID's messages give the flange of its robot",
    "policies/foam.py": "the shipped policies keep its hand and last links clear of the person",
    "policies/motion.py": "the shipped policies keep its tool clear of the person",
    "policies/state_machine.py": "the shipped policies know how far it reaches",
}


def test_its_limits_are_those_of_the_baked_arm() -> None:
    limits = np.stack([PANDA.joint_low_rad, PANDA.joint_high_rad], 1)
    assert np.array_equal(arrays_of(PANDA.source)["joint_range_rad"], limits)


@pytest.mark.parametrize("name", shipped_protocols())
def test_the_shipped_protocols_park_it_inside_them(name: str) -> None:
    for rules in load_levels(name).values():
        parked = rules.scene.parked_joint_rad
        assert (np.array(PANDA.joint_low_rad) < parked).all()
        assert (np.array(PANDA.joint_high_rad) > parked).all()


def test_the_papers_protocol_parks_it_at_its_own_posture() -> None:
    assert load_protocol("bathing-v3").scene.parked_joint_rad == PANDA.parked_joint_rad


@pytest.mark.parametrize("robot", EMBODIMENTS.values(), ids=list(EMBODIMENTS))
def test_the_tool_centre_point_is_the_tip_s_outermost_point(robot: Robot) -> None:
    assert robot.tcp_z_m == pytest.approx(robot.tip_centre_z_m + robot.tip.half_m[2], abs=1e-15)
    assert robot.tcp_z_m == PANDA.tcp_z_m, "policies and dialects know one place of the tool centre point"


def test_embodiments_have_names_of_their_own() -> None:
    assert len({robot.id for robot in EMBODIMENTS.values()}) == len({r.tip.geom for r in EMBODIMENTS.values()}) == 2


def test_nothing_but_its_description_and_the_policies_names_the_panda() -> None:
    sources = Path(carecontact.__file__).parent
    naming = {
        path.relative_to(sources).as_posix()
        for path in sources.rglob("*.py")
        if re.search(r"panda(?!s)", path.read_text(encoding="utf-8"), re.IGNORECASE)
    }
    assert naming == NAMES_THE_PANDA.keys(), "take the robot from the scene, the simulation or an argument"


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
            "action_space: expected one of cartesian_delta, cartesian_pose, droid_joint_velocity, joint_position, got",
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
        *("action_bounds", "joint_low_rad", "joint_high_rad", "camera_sizes_px", "time_limit_s", "compliance"),
        *("force_bias_n", "joint_friction_nm"),
    }


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


@pytest.mark.parametrize(
    ("text", "kind"),
    [("hover", "registered"), ("my_policy:Mine", "importable"), ("my.package:make", "importable")],
)
def test_names_and_classes_keep_their_text(text: str, kind: str) -> None:
    ref = PolicyRef.parse(text)
    assert (ref.kind, ref.text, str(ref)) == (kind, text, text)


@pytest.mark.parametrize(
    ("text", "shown", "place", "credentials"),
    [
        ("ws://gpu-3.example.org:8765/", "ws://gpu-3.example.org:8765", ("gpu-3.example.org", 8765), ""),
        ("ws://u:p%2Fw@[fe80::1]:80", "ws://[fe80::1]:80", ("fe80::1", 80), "u:p/w"),
    ],
)
def test_an_address_shows_no_credentials(text: str, shown: str, place: tuple[str, int], credentials: str) -> None:
    ref = PolicyRef.parse(text)
    assert (ref.kind, ref.text, (ref.host, ref.port), ref.credentials) == ("remote", shown, place, credentials)
    assert "p/w" not in repr(ref)
    assert PolicyRef.parse(ref.text).text == ref.text


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ws://host", "expected ws://HOST:PORT"),
        ("ws://:80", "expected ws://HOST:PORT"),
        ("ws://host:0", "expected ws://HOST:PORT"),
        ("ws://host:99999", "Port out of range"),
        ("ws://user:secret@host:80/path", "policy 'ws://host:80/path': expected"),
        ("wss://user:secret@host:80", "policy 'wss://host:80': expected ws://HOST:PORT.*; for an encrypted connection"),
        ("http://host:80", "expected ws://HOST:PORT"),
        ("ws://secret@host:80", "expected USER:PASSWORD before the @"),
    ],
)
def test_a_malformed_address_is_refused_without_its_password(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        PolicyRef.parse(text)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "shown", "scheme", "path", "options"),
    [
        (
            "openpi://gpu:8000?horizon=5&profile=pi05-droid",
            "openpi://gpu:8000?profile=pi05-droid&horizon=5",
            "openpi",
            "/",
            {"profile": "pi05-droid", "horizon": "5"},
        ),
        (
            "roboarena://[fe80::1]:8091/v1/realtime/robot/openpi?exterior=0",
            "roboarena://[fe80::1]:8091/v1/realtime/robot/openpi?exterior=0",
            "roboarena",
            "/v1/realtime/robot/openpi",
            {"exterior": "0"},
        ),
        ("vla-eval://gpu:8000/", "vla-eval://gpu:8000", "vla-eval", "/", {}),
        (
            "vla-eval://gpu:8000?space=joint_position",
            "vla-eval://gpu:8000?space=joint_position",
            "vla-eval",
            "/",
            {"space": "joint_position"},
        ),
    ],
)
def test_the_address_of_a_dialect_has_a_path_and_options(
    text: str, shown: str, scheme: str, path: str, options: dict[str, str]
) -> None:
    ref = PolicyRef.parse(text)
    assert (ref.kind, ref.text, ref.scheme, ref.path, dict(ref.options)) == ("remote", shown, scheme, path, options)
    assert PolicyRef.parse(shown) == ref


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("openpi://host", r"expected openpi://HOST:PORT\[/PATH\]\?profile=NAME, for example"),
        (
            "openpi://host:80?profil=x",
            r"no option named 'profil' \(did you mean 'profile'\?\); valid: profile, horizon",
        ),
        ("openpi://host:80?profile=", "profile: expected a value, got none"),
        ("openpi://host:80?profile", "expected openpi://HOST:PORT"),
        ("openpi://host:80?horizon=0", "horizon: expected 1 to 2000 actions, got '0'"),
        ("openpi://host:80?horizon=99999999999", "horizon: expected 1 to 2000 actions"),
        ("openpi://host:80?exterior=2", "exterior: expected 0 or 1"),
        ("openpi://host:80?exterior=1&exterior=0", "expected each option once"),
        ("roboarena://host:80?horizon=8", "no option named 'horizon'; valid: exterior"),
        ("vla-eval://host:80?horizon=8", "no option named 'horizon'; valid: space"),
        ("openpi://:secret@host:80", "a key never stands in the address; put it into CARECONTACT_API_KEY"),
        ("openpi://secret@host:80", "a key never stands in the address; put it into CARECONTACT_API_KEY"),
        ("opnpi://host:80", r"other schemes: openpi, roboarena, vla-eval \(did you mean 'openpi'\?\)"),
        ("ws://host:80?profile=x", "expected ws://HOST:PORT"),
    ],
)
def test_a_malformed_address_of_a_dialect_says_what_is_valid(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        PolicyRef.parse(text)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    "text", [":", "module:", ":Class", "a b:Class", "module:Class:x", "../up:Class", "m:os.system"]
)
def test_a_malformed_class_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected module:Class"):
        PolicyRef.parse(text)


@pytest.mark.parametrize("text", ["hover", "my:Own", "ws://192.0.2.7:8765", "openpi://192.0.2.7:80?profile=pi05-droid"])
def test_a_variant_is_part_of_what_results_name_and_no_part_of_where_the_policy_is(text: str) -> None:
    plain, varied = PolicyRef.parse(text), PolicyRef.parse(f"{text}+shuffled-look")
    assert (varied.text, varied.name, varied.variant) == (f"{plain.text}+shuffled-look", plain.text, "shuffled-look")
    assert (varied.kind, varied.host, varied.port, varied.options) == (
        plain.kind,
        plain.host,
        plain.port,
        plain.options,
    )
    assert varied == plain.with_variant("shuffled-look")
    assert PolicyRef.parse(varied.text) == varied


@pytest.mark.parametrize("variant", ["noise-0mm", "noise-100mm", "noise-8", "blind"])
def test_what_is_no_variant_stays_part_of_the_name(variant: str) -> None:
    assert PolicyRef.parse(f"hover+{variant}").variant == ""


def test_a_card_names_on_whom_the_policy_was_trained() -> None:
    card = PolicyCard(name="p", trained_on=("ab" * 32, "bathing-wide-v2:0-26,30"))
    assert card.plain()["trained_on"] == ["ab" * 32, "bathing-wide-v2:0-26,30"]
    assert "trained_on" not in PolicyCard(name="p").plain()
    for wrong in ("0-26", ("0-26",), ("exam:",), ("exam:0 to 3",), (3,), ("AB" * 32,)):
        with pytest.raises(ContractError, match=r"PolicyCard.trained_on: expected .*PROTOCOL:SEEDS"):
            PolicyCard(name="p", trained_on=wrong)  # type: ignore[arg-type]
