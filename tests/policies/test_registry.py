from __future__ import annotations

import importlib
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from carecontact import registry
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.interface.action import Action
from carecontact.interface.observation import CameraView
from carecontact.interface.policy import PolicyRef
from carecontact.policies.blind import ZeroAction
from carecontact.policies.registry import POLICIES, PolicyRow, is_privileged, policy_target, role_of
from carecontact.policies.state_machine import StateMachine
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import canonical_hash
from carecontact.running.trial import run_trial
from carecontact.scoring import score_recording
from carecontact.serving.arguments import ArgumentError, bind, load_factory, parameters_of
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import PolicyProcess
from tests.installed import look_again
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view


def _blind(view: CameraView, modalities: tuple[str, ...]) -> CameraView:
    """Only the requested modalities, and no person in view."""
    return CameraView(
        intrinsics=view.intrinsics,
        pose_camera_in_base=view.pose_camera_in_base,
        rgb=view.rgb if "rgb" in modalities else None,
        depth=view.depth if "depth" in modalities else None,
        points=np.zeros((47, 3), np.float32) if "points" in modalities else None,
        point_colors=np.zeros((47, 3), np.uint8) if "points" in modalities else None,
        masks=view.masks if "masks" in modalities else None,
        landmarks=np.full((33, 3), np.nan, np.float32) if "landmarks" in modalities else None,
        landmarks_in_base=np.full((33, 3), np.nan, np.float32) if "landmarks" in modalities else None,
    )


HOSTED = [name for name in POLICIES if POLICIES[name].role != "privileged"]


@pytest.mark.parametrize("name", HOSTED)
def test_every_registered_policy_keeps_the_contract(name: str) -> None:
    """Starts behind the wall, shows a card, and answers an empty scene with valid actions."""
    assert re.fullmatch(r"[\w.]+:\w+", POLICIES[name].target)
    assert 20 < len(POLICIES[name].description) < 120
    with PolicyProcess(PolicySetup.of(name), first_deadline_s=20, deadline_s=20) as process:
        card = process.start()
        assert card.name.replace("_", "-") == name
        process.reset(load_protocol("bathing-v3").tasks[0].prompt, SESSION)
        view = _blind(synthetic_view(), card.modalities)
        reply = process.act(synthetic_observation(cameras=dict.fromkeys(card.cameras, view)))
    assert reply.actions
    # A policy that looks for a person and sees none stays in place.
    if "landmarks" in card.modalities:
        assert all(action.pose_tcp_in_base is None for action in reply.actions)


@pytest.mark.parametrize("name", HOSTED)
def test_every_registered_policy_takes_the_arguments_that_it_lists_and_no_other(name: str) -> None:
    """Each has a default, because a registered policy runs by its name alone, and a type that a text can become."""
    factory = load_factory(POLICIES[name].target)
    parameters = parameters_of(factory)
    assert not [parameter.name for parameter in parameters if parameter.required]
    types = {str(parameter).partition(": ")[2].split()[0] for parameter in parameters}
    assert types <= {"int", "float", "bool", "str", "Path"}
    takes_language = {"language", "record"} <= {parameter.name for parameter in parameters}
    assert takes_language == bool(POLICIES[name].languages)
    assert bind(factory, {}) == {}
    with pytest.raises(ArgumentError, match="it has no argument 'no_such'"):
        bind(factory, {"no_such": "1"})


def test_zero_action_never_ends_and_never_moves() -> None:
    assert (ZeroAction.card.modalities, ZeroAction.card.cameras) == ((), ())
    actions = ZeroAction().act(synthetic_observation())
    assert len(actions) / ZeroAction.card.control_hz >= SESSION.time_limit_s
    assert all(a.pose_tcp_in_base is None and a.stiffness is None and not a.done for a in actions)


def test_names_resolve_without_importing() -> None:
    assert policy_target(PolicyRef.parse("zero-action")) == "carecontact.policies.blind:ZeroAction"
    assert policy_target(PolicyRef.parse("nowhere.to_be:Found")) == "nowhere.to_be:Found"


def test_an_unknown_name_lists_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"named 'zero' .*; valid: .*hover.*state-machine.*zero-action"):
        policy_target(PolicyRef.parse("zero"))


def test_other_packages_add_policies_through_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    row = PolicyRow(target="theirs.policy:Theirs", description="Somebody's policy.")
    point = SimpleNamespace(name="theirs", value="theirs:ROW", load=lambda: row, dist=None)
    monkeypatch.setattr(registry, "entry_points", lambda *, group: [point] if group == "carecontact.policies" else [])
    look_again(monkeypatch, POLICIES)
    assert policy_target(PolicyRef.parse("theirs")) == "theirs.policy:Theirs"
    assert "theirs" in list(POLICIES)


def test_a_privileged_policy_has_no_process_of_its_own() -> None:
    with pytest.raises(ConfigError, match=r"policy oracle is privileged: .* cannot be served"):
        PolicyProcess(PolicySetup.of("oracle"), first_deadline_s=20, deadline_s=20)


def test_another_packages_row_is_never_privileged(monkeypatch: pytest.MonkeyPatch) -> None:
    row = PolicyRow(target="theirs.policy:Theirs", description="Somebody's policy.", role="privileged")
    dist = SimpleNamespace(name="theirs", version="1")
    point = SimpleNamespace(name="theirs", value="theirs:ROW", load=lambda: row, dist=dist)
    monkeypatch.setattr(registry, "entry_points", lambda *, group: [point] if group == "carecontact.policies" else [])
    look_again(monkeypatch, POLICIES)
    assert not is_privileged(PolicyRef.parse("theirs"))
    assert is_privileged(PolicyRef.parse("oracle"))


def test_who_has_no_row_is_a_method() -> None:
    assert (role_of("state-machine"), role_of("hover"), role_of("oracle")) == ("method", "blind", "privileged")
    assert role_of("my.own:Policy") == role_of("ws://h:1") == "method"


ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def test_the_readme_shows_the_example() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks == [(EXAMPLES / "my_policy.py").read_text()]


def test_the_own_loop_makes_the_recording_of_a_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    loop, my_policy = (importlib.import_module(name) for name in ("own_loop", "my_policy"))
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="my_policy:MyPolicy")
    mine = loop.run(spec, my_policy.MyPolicy())
    trial = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(EXAMPLES)]))
    assert canonical_hash(mine) == canonical_hash(trial)


def test_my_policy_raises_the_tool_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    policy, observation = importlib.import_module("my_policy").MyPolicy(), synthetic_observation()
    policy.reset("gently touch the right forearm")
    *moves, end = policy.act(observation)
    rise = np.array([move.pose_tcp_in_base for move in moves]) - observation.pose_tcp_in_base
    np.testing.assert_allclose(rise[:, 2], 0.005 * np.arange(1, 11), atol=1e-12)
    np.testing.assert_allclose(np.delete(rise, 2, axis=1), 0, atol=1e-12)
    assert end.done


def test_press_deeper_lowers_the_state_machines_targets_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    pose = np.array([0.5, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0])
    plan = [*[Action(pose_tcp_in_base=pose)] * 12, Action(done=True)]
    monkeypatch.setattr(StateMachine, "act", lambda self, observation: plan)
    policy = importlib.import_module("press_deeper").PressDeeper(by_m=0.006)
    *moves, end = policy.act(synthetic_observation())
    lowered = pose - np.array([move.pose_tcp_in_base for move in moves])
    np.testing.assert_allclose(lowered[:, 2], 0.0006 * np.minimum(np.arange(1, 13), 10), atol=1e-12)
    np.testing.assert_allclose(np.delete(lowered, 2, axis=1), 0, atol=1e-12)
    assert end.done
    assert policy.card.name == "press-deeper"


def test_the_example_look_and_press_looks_twice_and_presses_with_three_newtons_between() -> None:
    """In its own process, over the wire."""
    source = (EXAMPLES / "look_and_press.py").read_text()
    assert len(source.splitlines()) < 80
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="look_and_press:Press")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(EXAMPLES)]))
    assert recording.header.ended == "done", recording.header.failure
    assert score_recording(recording).safety_gated
    looked = np.flatnonzero(recording["policy/looked"].any(axis=1))
    assert looked.tolist() == [0, len(recording["policy/looked"]) - 1]
    assert recording["wall/renders"].tolist() == [2, 2, 2, 1, 2], "the empty cell is drawn once"
    force = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"], axis=2).sum(1)
    touching = np.flatnonzero(force > 0.5)
    assert np.median(force[touching]) == pytest.approx(3.0, abs=0.3)
    assert recording["policy/observation_time_s"][looked[1]] > recording["scorer/time_s"][touching[-1]]


def test_a_control_is_a_probe_and_a_demonstrator_stays_what_it_is() -> None:
    for name in ("shuffled-look", "frozen-look", "no-touch"):
        assert role_of(f"state-machine+{name}") == role_of(f"my:Own+{name}") == "probe"
    assert (role_of("state-machine+dagger"), role_of("mean-person+noise-8mm")) == ("method", "blind")
    assert role_of("oracle+noise-8mm") == "privileged"
    assert is_privileged(PolicyRef.parse("oracle+noise-8mm"))
    assert policy_target(PolicyRef.parse("hover+frozen-look")) == policy_target(PolicyRef.parse("hover"))
    assert policy_target(PolicyRef.parse("my.own:Policy+no-touch")) == "my.own:Policy"
