from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.errors import LanguageError, PolicyError
from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.action_spaces import check_action
from carecontact.interface.body_view import RegionGeometry, region_from_observation
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.interface.policy import Policy
from carecontact.interface.robot import Session
from carecontact.policies import state_machine as fixed
from carecontact.policies.motion import CAP_RADIUS_M, CONTROL_HZ, FREE_SPEED_M_S, NEAR_SPEED_M_S, Leg, sample
from carecontact.policies.state_machine import StateMachine, candidates, push, reachable, scrub, touch
from carecontact.protocol.load import load_protocol
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.process import PolicyProcess
from tests.interface.lying_person import HEIGHT, LIMB_RADIUS, WIDTH, Person, change_view, observe
from tests.policies.language.endpoint import endpoint, error, says

MakeSession = Callable[..., Session]
PROMPTS = [task.prompt for task in load_protocol("bathing-v3").tasks]


def plan(observation: Observation, prompt: str, session: Session) -> list[Action]:
    policy = StateMachine()
    policy.configure(session)
    policy.reset(prompt)
    return list(policy.act(observation))


def poses_of(actions: list[Action]) -> np.ndarray:
    return np.array([action.pose_tcp_in_base for action in actions])


@pytest.mark.parametrize("prompt", PROMPTS)
def test_every_task_has_a_plan_within_all_limits(
    observation: Observation, person: Person, session: MakeSession, prompt: str
) -> None:
    actions = plan(observation, prompt, session())
    assert len(actions) <= MAX_CHUNK
    assert len(actions) / CONTROL_HZ < 25
    assert [action.done for action in actions] == [False] * (len(actions) - 1) + [True]
    for action in actions:
        check_action(action, session().action_bounds)
    poses = np.vstack([observation.pose_tcp_in_base, poses_of(actions)])
    speed = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) * CONTROL_HZ
    assert speed.max() <= FREE_SPEED_M_S + 1e-9
    near = person.clearance(poses[1:, :3]) < fixed.NEAR_M
    assert near.any()
    assert speed[near].max() <= NEAR_SPEED_M_S + 1e-9
    # Ends well clear of the person.
    assert person.clearance(poses[-1:, :3])[0] > 0.05


def test_touch_ends_on_the_named_region(observation: Observation, person: Person, session: MakeSession) -> None:
    poses = poses_of(plan(observation, "gently touch the right forearm", session()))
    lowest = poses[poses[:, 2].argmin(), :3]
    middle = (person.elbow + person.wrist) / 2
    assert np.linalg.norm(lowest[:2] - middle[:2]) < 0.01
    assert lowest[2] == pytest.approx(2 * LIMB_RADIUS - fixed.TOUCH_DEPTHS_M[0], abs=0.003)
    assert (np.abs(poses[:, 2] - lowest[2]) < 1e-9).sum() >= 1.5 * CONTROL_HZ


def test_the_way_goes_over_the_person(observation: Observation, person: Person, session: MakeSession) -> None:
    poses = poses_of(plan(observation, "gently touch the abdomen", session()))
    first_near = int(np.argmax(person.clearance(poses[:, :3]) < 0.05))
    goal = poses[poses[:, 2].argmin(), :2]
    assert np.linalg.norm(poses[first_near, :2] - goal) < 1e-6


def test_a_blank_image_ends_without_touching(session: MakeSession, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        actions = plan(observe(None), "gently touch the right forearm", session())
    assert actions == [Action(done=True)]
    assert "found in the image" in caplog.text


def test_a_hidden_arm_ends_without_touching(observation: Observation, session: MakeSession) -> None:
    empty = dict(observation.cameras["overhead"].masks or {}, human=np.zeros((HEIGHT, WIDTH), bool))
    actions = plan(change_view(observation, masks=empty), "push the right forearm", session())
    assert actions == [Action(done=True)]


def test_out_of_the_workspace_ends_without_touching(
    observation: Observation, session: MakeSession, caplog: pytest.LogCaptureFixture
) -> None:
    actions = plan(observation, "gently touch the right forearm", session(low=(-0.2, -1.1, 0.3)))
    assert actions == [Action(done=True)]
    assert "workspace" in caplog.text


def test_an_arm_that_is_not_seen_ends_without_touching(observation: Observation, session: MakeSession) -> None:
    assert plan(observation, "gently touch the left forearm", session()) == [Action(done=True)]


def test_an_instruction_that_is_not_understood_is_refused() -> None:
    with pytest.raises(LanguageError, match="which forearm"):
        StateMachine().reset("touch the forearm")


def test_the_card() -> None:
    policy = StateMachine()
    assert isinstance(policy, Policy)
    assert policy.card.language_backend == "rules-v1"
    assert policy.card.cameras == ("overhead",)


@pytest.mark.parametrize(("region", "pushes"), [("forearm", True), ("abdomen", False)])
def test_the_choice_is_bounded(observation: Observation, region: str, pushes: bool) -> None:
    geometry = region_from_observation(observation, region)  # pyright: ignore[reportArgumentType]
    found = candidates(geometry, start_pose=observation.pose_tcp_in_base, travel_height_m=0.3, bounds=None)
    assert len(found) <= 40
    assert {"touch", "scrub"} <= {c.option.primitive for c in found}
    assert any(c.option.primitive == "push" for c in found) == pushes
    assert len({c.option for c in found}) == len(found)


def test_reach(observation: Observation) -> None:
    forearm = region_from_observation(observation, "forearm")
    legs = touch(forearm, key_point=0.5, depth_m=0.012, speed_m_s=0.03)
    assert reachable(legs)
    for metres in (0.5, -0.3):
        shift = metres * forearm.centre_m / np.linalg.norm(forearm.centre_m)
        moved = [Leg(points=leg.points + shift, quat_wxyz=leg.quat_wxyz, speed_m_s=0.1) for leg in legs]
        assert not reachable(moved)


def test_a_person_who_lies_too_far_away(session: MakeSession, caplog: pytest.LogCaptureFixture) -> None:
    person = Person(shoulder=np.array([0.95, -0.75, LIMB_RADIUS]))
    assert plan(observe(person), "gently touch the right upper arm", session()) == [Action(done=True)]
    assert "workspace" in caplog.text


@pytest.fixture(scope="module")
def forearm(observation: Observation) -> RegionGeometry:
    return region_from_observation(observation, "forearm")


def knots(legs: list[Leg]) -> np.ndarray:
    return np.vstack([leg.points for leg in legs])


def test_touch_goes_straight_down_to_its_depth(forearm: RegionGeometry) -> None:
    legs = touch(forearm, key_point=0.5, depth_m=0.012, speed_m_s=0.03)
    points = knots(legs)
    np.testing.assert_allclose(points[:, :2], np.tile(forearm.centre_m[:2], (3, 1)), atol=1e-3)
    assert points[1, 2] == pytest.approx(forearm.surface(0.0)[2] - 0.012)
    assert legs[1].hold_s >= 1.5
    np.testing.assert_allclose(matrix_from_quat(legs[1].quat_wxyz)[:, 2], [0, 0, -1], atol=1e-9)


def test_key_points_lie_along_the_limb(forearm: RegionGeometry) -> None:
    near, far = (knots(touch(forearm, key_point=k, depth_m=0.012, speed_m_s=0.03))[1] for k in (0.35, 0.65))
    assert (far - near) @ forearm.axis == pytest.approx(0.3 * 2 * forearm.half_length_m, rel=0.02)


def test_scrub_strokes_and_turns(forearm: RegionGeometry) -> None:
    legs = scrub(forearm, key_point=0.5, depth_m=0.015, speed_m_s=0.07)
    start = np.concatenate([legs[0].points[0], legs[0].quat_wxyz])
    poses = np.array(list(sample(legs[1:-1], start)))
    along = (poses[:, :3] - forearm.centre_m) @ forearm.axis
    assert along.min() == pytest.approx(-0.06, abs=0.003)
    assert along.max() == pytest.approx(0.06, abs=0.003)
    moving = np.sign(np.diff(along)[np.abs(np.diff(along)) > 1e-4])
    assert (np.diff(moving) != 0).sum() == fixed.SCRUB_PASSES
    low = poses[np.isclose(poses[:, 2], poses[:, 2].min(), atol=0.01)]
    skin = np.array([forearm.surface(a)[2] for a in (low[:, :3] - forearm.centre_m) @ forearm.axis])
    np.testing.assert_allclose(skin - low[:, 2], 0.015, atol=0.01)


def test_scrub_stays_on_a_short_region(forearm: RegionGeometry) -> None:
    legs = scrub(forearm, key_point=0.9, depth_m=0.015, speed_m_s=0.07)
    along = (knots(legs) - forearm.centre_m) @ forearm.axis
    assert np.abs(along).max() <= forearm.half_length_m


@pytest.mark.parametrize("towards_base", [True, False])
def test_push_is_level_and_across(forearm: RegionGeometry, towards_base: bool) -> None:
    legs = push(forearm, key_point=0.7, depth_m=0.06, speed_m_s=0.05, support_height_m=0.0, towards_base=towards_base)
    _, low, pushed, away, _ = (leg.points[-1] for leg in legs)
    stroke = pushed - low
    assert stroke[2] == 0
    assert abs(stroke @ forearm.axis) < 0.01 * np.linalg.norm(stroke)
    place = forearm.surface(0.4 * forearm.half_length_m)
    start_gap = np.linalg.norm((low - place)[:2]) - forearm.radius_m - CAP_RADIUS_M
    assert start_gap == pytest.approx(fixed.PUSH_STANDOFF_M, abs=1e-6)
    assert np.linalg.norm(stroke) == pytest.approx(fixed.PUSH_STANDOFF_M + 0.06)
    assert (np.linalg.norm(low[:2]) < np.linalg.norm(place[:2])) == towards_base
    # Over the support by the clearance, and not over the limb's middle.
    assert 0.015 <= low[2] <= forearm.centre_m[2] / 2
    assert (away - low) @ stroke < 0
    # The hand leans away from the limb.
    tool_axis = matrix_from_quat(legs[1].quat_wxyz)[:, 2]
    assert tool_axis @ stroke / np.linalg.norm(stroke) == pytest.approx(np.sin(fixed.PUSH_TILT_RAD))


READ = says(json.dumps({"action": "touch", "region": "forearm", "side": "right", "manner": "none", "unclear": ""}))
CHOSE = says('{"number": 7, "reason": "in the middle"}')


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, observation: Observation, session: MakeSession) -> Callable[..., Any]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")

    def trial(language: str = "rules-v1", *, url: str = "", record: Path | None = None) -> dict[str, Any]:
        monkeypatch.setenv("OPENAI_BASE_URL", url)
        policy = StateMachine(language=language, record=record)
        policy.configure(session())
        policy.reset("touch the right forearm")
        actions = policy.act(observation)
        assert actions[0].pose_tcp_in_base is not None
        return {**policy.take_notes(), "backend": policy.card.language_backend, "count": len(actions)}

    return trial


def test_a_model_chooses_and_its_recording_replays(run: Callable[..., dict], tmp_path: Path) -> None:
    record = tmp_path / "answers.jsonl"
    with endpoint(READ, CHOSE) as server:
        live = run("live:m-1", url=server.url, record=record)
    replayed = run(f"replay:{record}")
    assert live["backend"] == "live:m-1"
    assert replayed["backend"].endswith(":m-1")
    assert live["chosen"] == replayed["chosen"] == 7
    assert (live["options"], live["count"]) == (replayed["options"], replayed["count"])
    assert [c["purpose"] for c in live["language"]] == ["parse", "choose"]
    for a, b in zip(live["language"], replayed["language"], strict=True):
        assert (a["request_sha256"], a["completion_sha256"]) == (b["request_sha256"], b["completion_sha256"])


def test_options_and_choice_are_noted_under_rules_too(run: Callable[..., dict]) -> None:
    notes = run()
    chosen = notes["options"][notes["chosen"]]
    assert (chosen["primitive"], chosen["key_point"], chosen["approach"]) == ("touch", 0.5, "above")
    assert len(chosen["corners_px"]) == len(chosen["corners_m"]) == 1
    assert all(0 <= u < 640 and 0 <= v < 480 for o in notes["options"] for u, v in o["corners_px"])
    assert "language" not in notes


def test_a_wrong_endpoint_is_the_methods_failure(monkeypatch: pytest.MonkeyPatch, session: MakeSession) -> None:
    """Also in a process of its own, from which no traceback comes out."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    setup = replace(PolicySetup.of("state-machine"), language="live:m-1")
    with endpoint(error(500, "out of memory")) as server:
        monkeypatch.setenv("OPENAI_BASE_URL", server.url)
        with PolicyProcess(setup, first_deadline_s=20, deadline_s=20) as process:
            process.start()
            with pytest.raises(PolicyError, match=r"live:m-1: .*HTTP 500: .*out of memory") as caught:
                process.reset("touch the right forearm", session())
    assert caught.value.kind == "language"
    assert "Traceback" not in str(caught.value)
