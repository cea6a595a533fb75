"""Environments for learning over many steps and episodes, in processes of their own, and beside other libraries."""

from __future__ import annotations

import gc
import importlib.util
import warnings

import gymnasium as gym
import numpy as np
import psutil
import pytest

from carecontact.learn import Bathing, make_vec
from tests.learn.test_bathing import DONE, DOWNWARD, IDS


@pytest.mark.slow
def test_a_thousand_random_steps() -> None:
    env = Bathing(("T1", "T5"), "L1", 3)
    env.action_space.seed(0)
    env.reset(seed=0)
    ends = 0
    for number in range(1000):
        row = env.action_space.sample()
        # A random row ends every second trial; some are to go on.
        row[6] = row[6] if number % 100 == 99 else -1.0
        seen, reward, terminated, truncated, _ = env.step(row)
        assert seen in env.observation_space
        assert reward in (0.0, 1.0)
        if terminated or truncated:
            ends += 1
            assert env.reset()[0] in env.observation_space
    assert ends > 3
    env.close()


@pytest.mark.slow
def test_two_processes_are_two_environments() -> None:
    arguments = {"persons": 2, "cameras": ("wrist",), "size": 64}
    vector = make_vec("carecontact/Bathing-T1-L1-v0", 2, **arguments)
    alone = [Bathing("T1", "L1", [number], cameras=("wrist",), size=64) for number in range(2)]
    together = vector.reset(seed=[3, 4])[0]
    single = [env.reset(seed=seed)[0] for env, seed in zip(alone, (3, 4), strict=True)]
    for row in [DOWNWARD] * 20 + [DONE]:
        for number in range(2):
            np.testing.assert_array_equal(together["agent_pos"][number], single[number]["agent_pos"])
            picture = single[number]["pixels"]["wrist"]
            np.testing.assert_array_equal(together["pixels"]["wrist"][number], picture)
        together, _, terminated, _, info = vector.step(np.stack([row, row]))
        single = [env.step(row)[0] for env in alone]
    assert terminated.all()
    assert info["task_description"].tolist() == ["gently touch the foam on the right forearm"] * 2
    assert vector.call("task_description") == ("gently touch the foam on the right forearm",) * 2
    assert vector.call("_max_episode_steps") == (300, 300)
    vector.close()
    for env in alone:
        env.close()


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [(), ("overhead", "wrist")], ids=["blind", "seeing"])
def test_two_hundred_episodes_leak_nothing(cameras: tuple[str, ...]) -> None:
    """Persons come and go, so that worlds and renderers are made and closed."""
    env, process, rss = Bathing("T1", "L0", 3, cameras=cameras, worlds=1), psutil.Process(), list[int]()
    for number in range(300):
        env.reset(seed=number)
        for _ in range(3):
            env.step(DOWNWARD)
        if number >= 100 and number % 20 == 0:
            gc.collect()
            rss.append(process.memory_info().rss)
    env.close()
    assert max(rss) - rss[0] < 20 << 20, [round(size / 2**20) for size in rss]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="stable-baselines3 is not installed")
@pytest.mark.parametrize("env_id", IDS)
def test_stable_baselines_finds_nothing_to_warn_of(env_id: str) -> None:
    from stable_baselines3.common.env_checker import check_env  # type: ignore[import-not-found]

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(env_id, persons=1, nested=False)
        check_env(env.unwrapped)
        env.close()
