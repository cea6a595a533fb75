"""When cameras take a view, against a clock; and what an episode, its messages and its recording hold of it."""

from __future__ import annotations

from dataclasses import replace
from math import floor

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.looks import Looks, flags
from carecontact.errors import ActionError
from carecontact.interface.action import Action
from carecontact.interface.observation import CameraView, LastViews, Observation
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording
from carecontact.recording.pictures import Pictures
from carecontact.serving.codec import act_message, decode_observation, encode_observation, observation_sha256
from carecontact.sim.impedance import steps_of_period

DT_S = 0.002


def card(**rates: float) -> PolicyCard:
    return PolicyCard(name="p", modalities=("rgb",), cameras=("overhead", "wrist"), control_hz=20, camera_hz=rates)


@pytest.mark.parametrize("hz", [0.3, 1.0, 5.0, 7.0, 15.0, 20.0, 50.0])
@pytest.mark.parametrize("control_hz", [7.0, 15.0, 20.0, 50.0])
def test_a_camera_keeps_its_rate(hz: float, control_hz: float) -> None:
    looks, periods, steps, times = Looks(card(overhead=hz), dt_s=DT_S), steps_of_period(control_hz, DT_S), 0, []
    for _ in range(round(30 * control_hz)):
        if "overhead" in looks.due(steps * DT_S):
            times.append(steps * DT_S)
        steps += next(periods)
    assert times[0] == 0.0
    if hz >= control_hz:
        assert len(times) == round(30 * control_hz)
        return
    assert len(times) == pytest.approx(30 * hz, abs=1)
    # No view is later than one control period after it was due, and no earlier than one physics step before.
    late = np.array(times) - np.arange(len(times)) / hz
    assert late.min() > -DT_S
    assert late.max() < 1 / control_hz + DT_S


def test_a_camera_without_a_rate_takes_a_view_for_every_observation() -> None:
    looks = Looks(card(overhead=1.0), dt_s=DT_S)
    assert [looks.due(k / 20) for k in range(3)] == [("overhead", "wrist"), ("wrist",), ("wrist",)]


def test_a_camera_of_rate_zero_takes_the_first_view_and_those_that_are_asked_for() -> None:
    looks, taken = Looks(card(overhead=0, wrist=0), dt_s=DT_S), []
    for k in range(6):
        if k in (2, 4):
            looks.ask(("wrist",))
        taken.append(looks.due(10.0 * k))
    assert taken == [("overhead", "wrist"), (), ("wrist",), (), ("wrist",), ()]


def test_a_view_that_is_asked_for_does_not_delay_one_that_is_due() -> None:
    looks, times = Looks(card(overhead=1.0, wrist=0), dt_s=DT_S), []
    for k in range(61):
        if k in (10, 19):
            looks.ask(("overhead",))
        if "overhead" in looks.due(k / 20):
            times.append(k / 20)
    assert times == [0.0, 0.5, 0.95, 1.0, 2.0, 3.0]


def test_after_a_long_chunk_a_camera_takes_one_view_and_not_all_that_it_missed() -> None:
    looks = Looks(card(overhead=5.0, wrist=0), dt_s=DT_S)
    assert [looks.due(t) for t in (0.0, 10.0, 10.05, 10.2)] == [("overhead", "wrist"), ("overhead",), (), ("overhead",)]


def test_flags_are_in_the_order_of_the_contract() -> None:
    assert flags(("wrist", "overhead")).tolist() == [name in ("wrist", "overhead") for name in CAMERAS]


def seen(time_s: float, *cameras: str) -> Observation:
    zeros = {"joint_position": np.zeros(7), "joint_velocity": np.zeros(7), "gripper_position": np.zeros(1)}
    views = {name: CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4)) for name in cameras}
    pose = np.array([0.4, 0, 0.3, 0, 1, 0, 0])
    return Observation(instruction="", sim_time_s=time_s, pose_tcp_in_base=pose, cameras=views, **zeros)


def times(observation: Observation) -> dict[str, float]:
    return {name: view.sim_time_s for name, view in observation.cameras.items()}


def test_an_observation_is_completed_with_the_last_view_and_its_time() -> None:
    last = LastViews()
    last.completed(seen(0.0, "overhead", "wrist"))
    last.completed(seen(0.1, "wrist"))
    shown = last.completed(seen(0.2))
    assert times(shown) == {"overhead": 0.0, "wrist": 0.1}
    assert shown.new == ()
    assert last.completed(seen(0.3, "overhead")).new == ("overhead",)
    last.forget()
    assert last.completed(seen(0.0, "wrist")).cameras.keys() == {"wrist"}


def test_only_new_views_are_sent_and_both_ends_hold_the_same() -> None:
    ours, theirs = LastViews(), LastViews()
    for time_s, new in ((0.0, ("overhead", "wrist")), (0.1, ()), (0.2, ("wrist",))):
        shown = ours.completed(seen(time_s, *new))
        message = encode_observation(shown)
        assert set(message["cameras"]) == set(new)  # pyright: ignore[reportArgumentType]
        assert act_message(shown) == act_message(seen(time_s, *new)), "a view has no time of its own on the wire"
        again = theirs.completed(decode_observation(message))
        assert again.new == shown.new
        assert times(again) == times(shown)


SIZE_PX = 64


def trial(asked: PolicyCard, actions: list[Action]) -> tuple[Recording, list[Observation]]:
    protocol = load_protocol("bathing-v3")
    size = {"width": SIZE_PX, "height": SIZE_PX}
    small = {name: camera.model_copy(update=size) for name, camera in protocol.cameras.items()}
    protocol = protocol.model_copy(update={"cameras": small})
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="p")
    with Episode(spec, card=asked, digest=observation_sha256) as episode:
        shown = [episode.reset()]
        for action in actions:
            step = episode.step(action)
            shown += [] if step.observation is None else [step.observation]
        return episode.finish(), shown


@pytest.fixture(scope="module")
def looked() -> tuple[Recording, list[Observation]]:
    """The overhead camera at 5 Hz, that of the wrist on request, at a control rate of 20 Hz."""
    actions = [Action(look=("wrist",) if k == 5 else ()) for k in range(9)]
    return trial(card(overhead=5.0, wrist=0.0), [*actions, Action(done=True)])


def test_an_episode_holds_the_last_view_of_every_camera(looked: tuple[Recording, list[Observation]]) -> None:
    _, shown = looked
    assert [floor(20 * seen.sim_time_s + 0.5) for seen in shown] == list(range(10))
    news = [("overhead", "wrist"), (), (), (), ("overhead",), (), ("wrist",), (), ("overhead",), ()]
    assert [seen.new for seen in shown] == news
    for seen in shown:
        assert set(seen.cameras) == {"overhead", "wrist"}
        assert all(view.rgb is not None for view in seen.cameras.values())
    assert shown[5].cameras["overhead"] is shown[4].cameras["overhead"]


def test_a_recording_says_which_views_were_new_and_holds_their_pictures(
    looked: tuple[Recording, list[Observation]],
) -> None:
    recording, shown = looked
    assert recording["policy/looked"].tolist() == [flags(seen.new).tolist() for seen in shown]
    assert recording["actions/look"].tolist() == [flags(("wrist",) if k == 5 else ()).tolist() for k in range(10)]
    pictures = Pictures(recording)
    assert set(pictures) == {(k, name, "rgb") for k, seen in enumerate(shown) for name in seen.new}
    for index, name, _ in pictures:
        np.testing.assert_array_equal(pictures[index, name, "rgb"], shown[index].cameras[name].rgb)
    assert recording["wall/renders"][0] == 5


def test_looks_change_nothing_else(looked: tuple[Recording, list[Observation]]) -> None:
    recording, shown = looked
    every, all_shown = trial(replace(card(), camera_hz={}), [*[Action()] * 9, Action(done=True)])
    assert "policy/looked" not in every
    assert "actions/look" not in every
    for path in every:
        if not path.startswith(("policy/", "wall/")):
            np.testing.assert_array_equal(recording[path], every[path], err_msg=path)
    for k, name, _ in Pictures(recording):
        np.testing.assert_array_equal(shown[k].cameras[name].rgb, all_shown[k].cameras[name].rgb)


def test_a_look_at_a_camera_that_the_card_does_not_name_is_refused() -> None:
    looks = Looks(card(overhead=0), dt_s=DT_S)
    with pytest.raises(ActionError, match=r"look: no camera 'bedside' on the card; valid: overhead, wrist"):
        looks.check(("wrist", "bedside"))
