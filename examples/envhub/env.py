"""The environments for LeRobot's EnvHub: put this file into a repository of the hub as `env.py`.

`make_env("USER/REPOSITORY", n_envs=4, trust_remote_code=True)` then calls the function below. What it returns, and that
pictures are `pixels`, the state `agent_pos` and success `is_success`, is as huggingface/lerobot 7427f318 has it
(docs/source/envhub.mdx; `preprocess_observation` in src/lerobot/envs/utils.py). Every environment is a person of the
training room; scores come from `carecontact run` alone.
"""

from carecontact.learn import make_vec

LEVEL = "L1"
TASKS = ("T1", "T3")


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """Return suite -> number of the task -> environments that step together."""
    vectors = (
        make_vec(f"carecontact/Bathing-{task}-{LEVEL}-v0", n_envs, asynchronous=use_async_envs) for task in TASKS
    )
    return {f"carecontact-{LEVEL}": dict(enumerate(vectors))}
