"""A random policy in an environment for learning: `python gym_random.py`, with carecontact[learn] installed."""

import gymnasium as gym

import carecontact.learn  # noqa: F401 - registers the environments

if __name__ == "__main__":
    env = gym.make("carecontact/Bathing-T1-L1-v0", persons=9)
    env.action_space.seed(0)
    seen, info = env.reset(seed=0)
    print(f"person {info['person']}: {info['task_description']}")
    for number in range(100):
        row = env.action_space.sample()
        # The last number ends the trial where it is above 0, and a random one is after two steps.
        row[6] = 1.0 if number % 25 == 24 else -1.0
        seen, reward, terminated, truncated, info = env.step(row)
        if terminated or truncated:
            print(f"step {number}: {info['ended']}, reward {reward:g}, tool at {seen['agent_pos'][:3].round(3)} m")
            seen, info = env.reset()
            print(f"person {info['person']}: {info['task_description']}")
    env.close()
