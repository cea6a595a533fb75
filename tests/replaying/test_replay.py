"""Recorded trials stepped again: what they land on, and what happens where they do not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.errors import RecordingError
from carecontact.protocols import load_protocol
from carecontact.recording import Recording
from carecontact.replaying.replay import CLOSE_M, STATE, Found, Replay, Stretch
from tests.scoring.synthetic import before_start


def changed(recording: Recording, **arrays: Any) -> Recording:
    return replace(recording, arrays={**recording.arrays, **{k.replace("__", "/"): v for k, v in arrays.items()}})


def test_every_stored_state_is_reached_to_the_last_bit(pressed: Recording) -> None:
    stretches = list(Replay(pressed).stretches(10.0))
    assert [stretch.kind for stretch in stretches] == ["exact"] * len(pressed["state/time_s"])
    steps = np.concatenate([stretch.steps for stretch in stretches])
    assert (np.diff(steps) == 50).all()
    assert steps[0] == 0
    assert len(pressed["scorer/time_s"]) - steps[-1] < 50


def test_a_shown_state_is_the_stored_one_where_there_is_one(pressed: Recording) -> None:
    for stretch, stored in zip(Replay(pressed).stretches(4.0), pressed["state/integration"], strict=True):
        assert np.array_equal(stretch.states[0], stored, equal_nan=True)


def test_a_trial_under_joint_control_is_reached_too() -> None:
    card = PolicyCard(name="j", action_space="joint_position", control="droid", modalities=(), control_hz=15)
    spec = TrialSpec(protocol=load_protocol("bathing-v3-draft"), task_id="T1", seed=1, policy="j")
    with Episode(spec, card=card) as episode:
        start = episode.reset().joint_position
        for number in range(20):
            offset = 0.004 * number * np.array([1, 0, 0, -1, 0, 0, 1.0])
            episode.step(Action(joint=start + offset, done=number == 19), observe=number == 7)
        recording = episode.finish()
    assert [stretch.kind for stretch in Replay(recording).stretches(10.0)] == ["exact", "exact"]


def test_a_world_that_rounds_otherwise_begins_each_second_from_its_stored_state(pressed: Recording) -> None:
    stored = pressed["state/integration"].copy()
    joint = Replay(pressed).model.joint("robot_joint1")
    stored[1:, 1 + int(joint.qposadr[0])] += 1e-7  # after the time
    stretches = list(Replay(changed(pressed, state__integration=stored)).stretches(4.0))
    assert {stretch.kind for stretch in stretches[:-1]} == {"close"}
    assert all(0 < stretch.off_m < CLOSE_M for stretch in stretches[:-1])
    assert np.array_equal(stretches[1].states[0], stored[1], equal_nan=True)


def test_where_the_commands_are_missing_states_are_interpolated(pressed: Recording) -> None:
    still = np.full_like(pressed["actions/pose_tcp_in_base"], np.nan)
    replay = Replay(changed(pressed, actions__pose_tcp_in_base=still))
    second = list(replay.stretches(4.0))[1]
    assert second.kind == "interpolated"
    assert second.off_m > CLOSE_M
    data, joint = mujoco.MjData(replay.model), replay.model.joint("robot_joint1")
    angles = []
    for state in (*second.states, pressed["state/integration"][2]):
        mujoco.mj_setState(replay.model, data, state, STATE)
        angles.append(float(data.qpos[joint.qposadr[0]]))
    assert np.allclose(np.diff(angles), np.diff(angles)[0], atol=1e-9), "even steps from stored state to stored state"
    assert abs(angles[-1] - angles[0]) > 1e-3


def test_a_trial_that_ended_before_it_began_cannot_be_shown() -> None:
    with pytest.raises(RecordingError, match=r"T5-s000|ended before t = 0"):
        Replay(before_start())


def test_states_of_another_size_are_refused(pressed: Recording) -> None:
    with pytest.raises(RecordingError, match=r"its states have \d+ numbers, this world's \d+; install the release"):
        Replay(changed(pressed, state__integration=pressed["state/integration"][:, :-4]))


def test_a_trial_with_a_secret_draw_is_refused(pressed: Recording) -> None:
    spec = pressed.header.spec.model_copy(update={"salt_sha256": "ab" * 32})
    with pytest.raises(RecordingError, match=r"T1-s000: its person was drawn with a secret"):
        Replay(replace(pressed, header=pressed.header.model_copy(update={"spec": spec})))


def test_the_worst_stretch_decides_what_is_said() -> None:
    found, nothing = Found(), np.zeros(0, np.int64)
    assert str(found) == "stepped again from the recording, bit for bit"
    for kind, off_m in (("close", 1e-4), ("interpolated", 2e-3), ("exact", 0.0)):
        found.take(Stretch(steps=nothing, states=np.zeros((0, 1)), kind=kind, off_m=off_m))  # type: ignore[arg-type]
    assert str(found) == (
        "interpolated between the states of each second, at most 2.00 mm off the tool's recorded path"
    )
