"""Noise that a demonstrator corrects, and the oracle's labels on another policy's actions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carecontact.errors import ConfigError
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.oracle import teaching
from carecontact.oracle.teaching import NOISE_S, REACH_M, STRAYED_S, teaching_of
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from tests.policies.synthetic import BOUNDS

PARKED = np.array([0.45, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0])


def episode(card: PolicyCard | None = None, *, seed: int = 0, task: str = "T1") -> Any:
    """The parts of an episode that teaching uses; ``place`` moves the tool and ``simulation.time_s`` the clock."""
    pose = np.eye(4)
    pose[:3, 3] = PARKED[:3]
    simulation = SimpleNamespace(
        time_s=0.0,
        data=None,
        control=SimpleNamespace(target_in_base=PARKED),
        encoders=SimpleNamespace(pose_tcp_in_base=lambda data: pose),
    )
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id=task, seed=seed, policy="p")
    return SimpleNamespace(
        card=card or PolicyCard(name="p", control_hz=20),
        spec=spec,
        task=spec.protocol.task(task),
        session=SimpleNamespace(action_bounds=BOUNDS),
        simulation=simulation,
        place=pose,
    )


def offsets(steps: int, **given: Any) -> np.ndarray:
    teach = teaching_of("noise-8mm", episode(**given))
    pairs = [teach(Action(pose_tcp_in_base=PARKED)) for _ in range(steps)]
    assert all(np.array_equal(wanted.pose_tcp_in_base, PARKED) for _, wanted in pairs)
    return np.array([executed.pose_tcp_in_base - PARKED for executed, _ in pairs])


def test_noise_has_the_named_size_and_forgets_itself() -> None:
    off = offsets(40_000)
    assert not off[:, 3:].any()
    np.testing.assert_allclose(off[:, :3].std(0), 0.008, rtol=0.08)
    apart = round(NOISE_S * 20)
    held = (off[:-apart, :3] * off[apart:, :3]).mean(0) / off[:, :3].var(0)
    np.testing.assert_allclose(held, np.exp(-1), atol=0.1)
    assert np.linalg.norm(off[0]) < 0.008


def test_task_and_seed_decide_the_noise() -> None:
    np.testing.assert_array_equal(offsets(5), offsets(5))
    assert not np.array_equal(offsets(5), offsets(5, seed=1))
    assert not np.array_equal(offsets(5), offsets(5, task="T3"))


def test_noise_is_on_a_target_that_is_kept_and_leaves_the_end() -> None:
    teach = teaching_of("noise-8mm", episode())
    teach(Action(pose_tcp_in_base=PARKED))
    executed, wanted = teach(Action(stiffness=(300.0, 20.0), done=True))
    assert (executed.stiffness, executed.done, wanted.done) == ((300.0, 20.0), True, True)
    np.testing.assert_array_equal(wanted.pose_tcp_in_base, PARKED)
    assert 0 < np.linalg.norm(executed.pose_tcp_in_base - PARKED) < 0.05


def test_a_policy_that_does_not_command_poses_demonstrates_nothing() -> None:
    card = PolicyCard(name="deltas", action_space="cartesian_delta")
    with pytest.raises(ConfigError, match=r"dagger: .*cartesian_pose.*deltas has the action space cartesian_delta"):
        teaching_of("dagger", episode(card))


class Walk:
    """An oracle whose targets go up by 10 mm each from where the tool is."""

    planned = 0

    def __init__(self, *_: object) -> None:
        Walk.planned += 1
        self._k = 0

    def target(self, tool: np.ndarray, time_s: float) -> Action:
        start = tool if self._k == 0 else self._start
        self._start, self._k = start, self._k + 1
        return Action(pose_tcp_in_base=start + np.array([0, 0, 0.01 * self._k, 0, 0, 0, 0]), done=self._k == 30)


@pytest.fixture
def walk(monkeypatch: pytest.MonkeyPatch) -> None:
    Walk.planned = 0
    monkeypatch.setattr(teaching, "Oracle", Walk)


def heights(made: Any, *, steps: int, hz: float = 20.0, x_m: float = 0.45, follows: bool = True) -> list[float]:
    """Heights of the labels while the tool is at ``x_m`` and, if it ``follows``, as high as the last label."""
    teach, found = teaching_of("dagger", made), []
    for k in range(steps):
        made.simulation.time_s = k / hz
        acted = Action(pose_tcp_in_base=PARKED)
        executed, wanted = teach(acted)
        assert executed is acted
        found.append(float(wanted.pose_tcp_in_base[2]))
        made.place[0, 3] = x_m
        made.place[2, 3] = found[-1] if follows else made.place[2, 3]
    return found


@pytest.mark.usefixtures("walk")
def test_labels_go_on_while_the_tool_follows_at_the_rate_of_the_oracle() -> None:
    np.testing.assert_allclose(heights(episode(), steps=4), 0.4 + 0.01 * np.arange(1, 5))
    np.testing.assert_allclose(heights(episode(), steps=3, hz=10), 0.4 + 0.01 * np.array([1, 3, 5]))
    assert Walk.planned == 2


@pytest.mark.usefixtures("walk")
def test_the_label_waits_for_a_tool_that_is_led_away_and_is_then_planned_from_there() -> None:
    found = heights(episode(), steps=round(20 * STRAYED_S), x_m=0.45 + 1.5 * REACH_M, follows=False)
    assert found == [found[0]] * len(found)
    assert Walk.planned == 1
    made = episode()
    heights(made, steps=3 + round(20 * STRAYED_S), x_m=0.45 + 1.5 * REACH_M, follows=False)
    assert Walk.planned == 3
