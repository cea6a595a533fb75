"""Several environments at once, each in a process of its own with one thread."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium as gym
from threadpoolctl import threadpool_limits

from carecontact.errors import ConfigError
from carecontact.learn.persons import numbers_of

Vector = gym.vector.VectorEnv[Any, Any, Any]


def make_vec(env_id: str, n: int, *, asynchronous: bool = True, **arguments: Any) -> Vector:
    """Return ``n`` environments that step together; one that has ended begins again with the next step.

    Where ``persons`` are given and there are at least ``n`` of them, each environment has a share of its own, so that
    each process has fewer worlds to keep.

    Args:
        env_id: such as ``carecontact/Bathing-T1-L1-v0``.
        n: one for each core is as fast as it gets.
        asynchronous: whether each has a process of its own; OpenGL then begins there, and nothing is shared.
        arguments: those of ``Bathing``.

    Raises ConfigError for ``n`` below 1.
    """
    if n < 1:
        raise ConfigError(f"make_vec.n: expected at least 1, got {n}")
    shares: list[dict[str, Any]] = [arguments] * n
    if "persons" in arguments and len(numbers := numbers_of(arguments["persons"])) >= n:
        shares = [{**arguments, "persons": numbers[first::n]} for first in range(n)]
    made = [partial(_made, env_id, share, alone=asynchronous) for share in shares]
    mode = gym.vector.AutoresetMode.NEXT_STEP
    if asynchronous:
        return gym.vector.AsyncVectorEnv(made, context="spawn", autoreset_mode=mode)
    return gym.vector.SyncVectorEnv(made, autoreset_mode=mode)


def _made(env_id: str, arguments: dict[str, Any], *, alone: bool) -> gym.Env[Any, Any]:
    if alone:
        threadpool_limits(1)
    return gym.make(env_id, disable_env_checker=True, **arguments)
