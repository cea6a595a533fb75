"""On level L0, whose persons need no search for a place of the robot; the slow tests have the other levels."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from carecontact.episode.episode import Episode
from carecontact.episode.perception import Peak
from carecontact.errors import ActionError, ConfigError, UnknownNameError
from carecontact.interface.action import Action
from carecontact.interface.learned import square
from carecontact.interface.policy import PolicyCard
from carecontact.learn import LEVELS, TASKS, TRAINING_SALT, Bathing, BathingState, make_vec
from carecontact.learn.bathing import POINTS
from carecontact.learn.persons import training_spec
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import commitment
from carecontact.recording import Recording, canonical_hash
from carecontact.runs.pooling import check_ranked
from carecontact.scoring import score_recording
from carecontact.sensing.builder import organised_points

DOWNWARD = np.array([0.2, 0, -0.5, 0, 0, 0, -1], np.float32)
DONE = np.array([0, 0, 0, 0, 0, 0, 1], np.float32)
IDS = [
    f"carecontact/Bathing{which}{kind}-v0"
    for kind in ("", "-State")
    for which in ("", *(f"-{task}-{level}" for task in TASKS for level in LEVELS))
]


@pytest.fixture(autouse=True)
def no_pictures_for_a_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})


@pytest.fixture(scope="module")
def blind() -> Iterator[Bathing]:
    """Two persons, two tasks and no pictures."""
    env = Bathing(("T1", "T6"), "L0", 2, cameras=(), record=True)
    yield env
    env.close()


@pytest.fixture(scope="module")
def state() -> Iterator[BathingState]:
    env = BathingState("T1", "L0", 1, reward="dense")
    yield env
    env.close()


def recorded(env: Bathing, seed: int, rows: int = 4) -> str:
    env.reset(seed=seed)
    for _ in range(rows):
        env.step(DOWNWARD)
    env.step(DONE)
    return canonical_hash(env.episode.finish())


def checked(env_id: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(env_id, persons=1)
        check_env(env.unwrapped)
        env.close()


@pytest.mark.parametrize("env_id", ["carecontact/Bathing-T1-L0-v0", "carecontact/Bathing-T1-L0-State-v0"])
def test_gymnasium_finds_nothing_to_warn_of(env_id: str) -> None:
    checked(env_id)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
def test_gymnasium_finds_nothing_to_warn_of_anywhere(env_id: str) -> None:
    checked(env_id)


def test_the_ids_are_every_task_on_every_level() -> None:
    assert {name for name in gym.registry if name.startswith("carecontact/")} == set(IDS)
    exam = load_protocol("bathing-wide-v2", level="L1")
    assert tuple(task.id for task in exam.tasks) == TASKS
    assert tuple(exam.levels) == LEVELS


def test_a_seed_gives_the_same_trial_whatever_came_before(blind: Bathing) -> None:
    once = recorded(blind, 5)
    others = {recorded(blind, seed, rows=seed) for seed in (1, 2, 3)}
    assert recorded(blind, 5) == once
    assert once not in others
    new = Bathing(("T1", "T6"), "L0", 2, cameras=(), record=True)
    assert recorded(new, 5) == once
    new.close()


@pytest.mark.slow
def test_a_seed_gives_the_same_trial_with_noise_and_movements() -> None:
    env = Bathing("T3", "L3", 3, points=True, record=True)
    first = env.reset(seed=1)[0]
    once = recorded(env, 1, rows=20)
    recorded(env, 2)
    again = env.reset(seed=1)[0]
    np.testing.assert_array_equal(first["pixels"]["wrist"], again["pixels"]["wrist"])
    np.testing.assert_array_equal(first["agent_pos"], again["agent_pos"])
    assert recorded(env, 1, rows=20) == once
    # The same person under another seed lies in the same place, and depth has other noise.
    others = [env.reset(seed=seed, options={"person": 0})[0] for seed in (1, 2)]
    np.testing.assert_array_equal(*(other["pixels"]["overhead"] for other in others))
    assert (others[0]["points"] != others[1]["points"]).any()
    env.close()


def test_a_person_and_a_task_can_be_chosen(blind: Bathing) -> None:
    _, info = blind.reset(seed=0, options={"person": 7, "task": "T3", "something else": 1})
    assert (info["person"], info["task"]) == (7, "T3")
    assert info["task_description"] == blind.task_description == "gently scrub the right forearm"
    assert not info["is_success"]
    with pytest.raises(UnknownNameError, match="no task named 'T8'"):
        blind.reset(options={"task": "T8"})
    with pytest.raises(ConfigError, match="persons"):
        blind.reset(options={"person": -1})


def test_no_trial_is_one_of_the_exam(blind: Bathing) -> None:
    """The persons of a seed with the training salt are drawn from other streams."""
    blind.reset(seed=0)
    assert blind.episode.spec.salt == TRAINING_SALT
    exam = training_spec(blind.protocol, "T1", 0).model_copy(update={"salt": ""})
    with Episode(exam, card=PolicyCard(name="exam", cameras=()), record=False) as episode:
        blind.reset(options={"person": 0, "task": "T1"})
        settled = "scorer/human_joint_settled"
        mine, theirs = (one.log.arrays()[settled] for one in (blind.episode, episode))
    assert np.abs(mine - theirs).max() > 1e-3


def test_ends_as_gymnasium_says(blind: Bathing) -> None:
    blind.reset(seed=0)
    assert blind.step(DOWNWARD)[2:4] == (False, False)
    last, reward, terminated, truncated, info = blind.step(DONE)
    assert (reward, terminated, truncated, info["ended"]) == (0.0, True, False, "done")
    assert last in blind.observation_space
    with pytest.raises(ConfigError, match="the trial has ended"):
        blind.step(DOWNWARD)


def test_the_time_limit_truncates_after_300_steps() -> None:
    env = Bathing("T1", "L0", 1, cameras=(), may_end=False)
    env.reset(seed=0)
    rows = 0
    truncated = False
    while not truncated:
        _, reward, terminated, truncated, info = env.step(DONE)
        rows += 1
        assert (reward, terminated) == (0.0, False)
    assert rows == env._max_episode_steps == 300
    assert info["ended"] == "time_limit"
    env.close()


def test_a_recording_is_refused_where_policies_are_ranked(blind: Bathing) -> None:
    recorded(blind, 3)
    recording = blind.episode.finish()
    assert recording.header.origin == "in-process"
    score = score_recording(recording)
    with pytest.raises(ConfigError, match=f"{score.trial_id}.h5 was recorded in-process"):
        check_ranked([score])
    assert recording.header.spec.commitment == commitment(TRAINING_SALT)


@pytest.mark.parametrize("reward", ["sparse", "dense"])
def test_a_recording_says_whether_the_reward_told_the_truth(reward: str) -> None:
    env = Bathing("T1", "L0", 1, cameras=(), reward=reward, record=True)
    recorded(env, 0, rows=1)
    assert env.episode.finish().header.privileged == (reward == "dense")
    env.close()


def test_a_dense_reward_adds_up_to_what_changed(state: BathingState) -> None:
    state.reset(seed=0)
    state.step(DOWNWARD)
    before = state.episode.progress()
    rewards = [state.step(DOWNWARD)[1] for _ in range(15)]
    after = state.episode.progress()
    assert after.distance_m < before.distance_m < 0.5
    assert after.safe
    assert sum(rewards) == pytest.approx(after.share - before.share + before.distance_m - max(after.distance_m, 0.0))


def test_the_state_is_what_the_simulation_has(state: BathingState) -> None:
    seen, info = state.reset(seed=0)
    assert not any(info["force_n"].values())
    for _ in range(80):
        to_region = seen["environment_state"][20:23] - seen["agent_pos"][:3]
        seen, *_, info = state.step([*np.clip(to_region / 0.025, -1, 1), 0, 0, 0, -1])
        if info["force_n"]["right_forearm"] > 1:
            break
    numbers = seen["environment_state"]
    assert seen in state.observation_space
    assert info["force_n"]["right_forearm"] > 1, "the state leads the tool to the region"
    assert np.linalg.norm(numbers[17:20]) == pytest.approx(info["force_n"]["right_forearm"], rel=1e-5)
    assert numbers[19] < 0, "it presses down"
    np.testing.assert_allclose(numbers[:17], list(info["force_n"].values()), rtol=1e-6)
    pose = state.episode.log.measured(["scorer/region_pose_in_world"])["scorer/region_pose_in_world"]
    regions = state.episode.protocol.regions
    base = state.episode.simulation.pose_base_in_world
    distance = np.linalg.norm(pose[-1, regions.index("forearm"), :3] - base[:3])
    assert np.linalg.norm(numbers[20:23]) == pytest.approx(distance, abs=1e-3)
    assert numbers[-7:].tolist() == [1, 0, 0, 0, 0, 0, 0]


def test_the_pictures_are_those_of_an_episode() -> None:
    nested, flat = (Bathing("T1", "L0", 1, size=64, points=True, nested=nested) for nested in (True, False))
    pictures = nested.reset(seed=0)[0]
    others = flat.reset(seed=0)[0]
    card = replace(nested.card, name="own")
    with Episode(nested.episode.spec, card=card) as episode:
        look = episode.reset()
        after = episode.step(Action(pose_tcp_in_base=look.pose_tcp_in_base)).observation
    assert after is not None
    for name in ("overhead", "wrist"):
        np.testing.assert_array_equal(pictures["pixels"][name], square(look.cameras[name].rgb, 64))
        np.testing.assert_array_equal(others[f"pixels.{name}"], square(look.cameras[name].rgb, 64))
        assert pictures["pixels"][name].std() > 10
    moved = nested.step(np.zeros(7))[0]
    np.testing.assert_array_equal(moved["pixels"]["overhead"], square(after.cameras["overhead"].rgb, 64))
    cloud, depth = pictures["points"], look.cameras["overhead"].depth
    assert depth is not None
    assert depth.shape == (480, 640), "a policy of the exam is given the same"
    assert cloud.shape == (POINTS, 6)
    whole = organised_points(depth, look.cameras["overhead"].intrinsics, look.cameras["overhead"].pose_camera_in_base)
    apart = np.abs(whole.reshape(-1, 3)[:, None] - cloud[None, :8, :3]).max(-1)
    assert (np.nanmin(apart, axis=0) < 1e-6).all()
    impedance = nested.protocol.impedance
    assert (cloud[:, :3] >= impedance.workspace_low_m).all()
    assert (cloud[:, :3] <= impedance.workspace_high_m).all()
    assert 0 <= cloud[:, 3:].min() < cloud[:, 3:].max() <= 1
    for env in (nested, flat):
        env.close()


def test_several_step_as_one_does_and_begin_again_with_the_next_step() -> None:
    """Autoreset is that of the next step: the last observation comes with the end, and the next row is not executed."""
    arguments: dict[str, Any] = {"persons": 2, "cameras": (), "worlds": 2}
    vector = make_vec("carecontact/Bathing-T1-L0-v0", 2, asynchronous=False, **arguments)
    alone = [Bathing("T1", "L0", [number], cameras=()) for number in range(2)]
    together = vector.reset(seed=[3, 4])[0]
    single = [env.reset(seed=seed)[0] for env, seed in zip(alone, (3, 4), strict=True)]
    for row in (DOWNWARD, DONE):
        for number in range(2):
            np.testing.assert_array_equal(together["agent_pos"][number], single[number]["agent_pos"])
        together, _, terminated, _, info = vector.step(np.stack([row, row]))
        single = [env.step(row)[0] for env in alone]
    assert terminated.all()
    assert not info["is_success"].any()
    assert info["person"].tolist() == [0, 1]
    np.testing.assert_array_equal(together["agent_pos"][1], single[1]["agent_pos"])
    first, _, terminated, _, _ = vector.step(np.stack([DONE, DONE]))
    assert not terminated.any()
    np.testing.assert_array_equal(first["agent_pos"][0], alone[0].reset()[0]["agent_pos"])
    vector.close()
    for env in alone:
        env.close()


def test_nothing_is_simulated_before_the_first_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise AssertionError("a world was built")

    monkeypatch.setattr("carecontact.learn.bathing.Episode", refused)
    env = gym.make("carecontact/Bathing-T1-L1-v0")
    assert env.observation_space["agent_pos"].shape == (29,)  # type: ignore[index]
    with pytest.raises(ConfigError, match="call reset"):
        env.unwrapped.step(np.zeros(7))
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tasks": "T8"}, "no task named 'T8'"),
        ({"tasks": ()}, "no task named ''"),
        ({"level": "L4"}, "no level named 'L4'"),
        ({"persons": 0}, r"Bathing.persons: expected .* got 0"),
        ({"persons": [1, 1]}, r"Bathing.persons: expected .* got \[1, 1\]"),
        ({"persons": [-1]}, r"Bathing.persons: expected .* got \[-1\]"),
        ({"persons": 2.5}, r"Bathing.persons: expected .* got 2.5"),
        ({"cameras": "overhead"}, r"Bathing.cameras: expected several names, such as \('overhead',\)"),
        ({"cameras": ("top",)}, "no camera named 'top'"),
        ({"size": 1000}, "Bathing.size: expected 32 to 480 px, got 1000"),
        ({"reward": "shaped"}, "no reward named 'shaped'"),
        ({"worlds": -1}, "Worlds.most: expected an integer of at least 0, got -1"),
        ({"render_mode": "human"}, "Bathing.render_mode: expected rgb_array or None, got 'human'"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Bathing(**arguments)


def test_a_wrong_row_is_named_and_changes_nothing(blind: Bathing) -> None:
    blind.reset(seed=0)
    with pytest.raises(ActionError, match="expected 7 finite numbers"):
        blind.step([0.0] * 6)
    with pytest.raises(ConfigError, match=r"make_vec.n: expected at least 1, got 0"):
        make_vec("carecontact/Bathing-v0", 0)
    blind.step(DOWNWARD)


def test_a_picture_for_people() -> None:
    env = Bathing("T1", "L0", 1, cameras=(), render_mode="rgb_array")
    env.reset(seed=0)
    shown = env.render()
    assert shown is not None
    assert shown.shape == (360, 640, 3)
    assert shown.std() > 10
    env.close()


class Led:
    """Stands for the rows of an environment whose actions another policy chooses."""

    def __init__(self, env: Bathing, policy: Any) -> None:
        self._env, self._policy, self._rows = env, policy, env._rows
        self._look: Any = None

    def begin(self, first: Any) -> None:
        self._look = first
        self._rows.begin(first)

    def action(self, row: object) -> Action:
        return self._policy.act(self._look)

    def agent_pos(self, look: Any) -> np.ndarray:
        self._look = look
        return self._rows.agent_pos(look)


@pytest.mark.parametrize(
    ("cls", "task", "level"),
    [
        (BathingState, "T1", "L1"),
        pytest.param(Bathing, "T1", "L0", marks=pytest.mark.slow),
        pytest.param(Bathing, "T3", "L2", marks=pytest.mark.slow),
        pytest.param(BathingState, "T6", "L3", marks=pytest.mark.slow),
    ],
)
def test_the_reward_of_a_trial_that_passes_is_one(cls: type[Bathing], task: str, level: str) -> None:
    """The oracle passes, and the reward agrees with the score of the recording: by the foam too, from L1 on."""
    from carecontact.oracle.policy import Oracle

    env = cls(task, level, 1, cameras=(), record=True)
    env.card = replace(env.card, control_hz=Oracle.card.control_hz)
    look = env.reset(seed=0)[0]
    episode = env.episode
    led = Led(env, Oracle(episode.simulation, episode.task, episode.session.action_bounds))
    led.begin(episode.look())
    env._rows = led  # type: ignore[assignment]
    assert look in env.observation_space
    rewards, ended = list[float](), False
    while not ended:
        look, reward, terminated, truncated, info = env.step(np.zeros(7))
        rewards.append(reward)
        ended = terminated or truncated
    recording: Recording = episode.finish()
    assert score_recording(recording).safety_gated
    assert info["is_success"]
    assert rewards[-1] == 1.0
    assert not any(rewards[:-1])
    if cls is BathingState:
        region, foam = look["environment_state"][20:23], look["environment_state"][32:35]
        off = np.linalg.norm(recording["scorer/foam_pose_in_region"][:3])
        assert np.linalg.norm(foam - region) == pytest.approx(off, abs=1e-5)
    env.close()
