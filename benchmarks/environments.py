"""Steps a second of an environment for learning, beside a new Episode for each trial, as JSON on standard output.

    python benchmarks/environments.py [--persons 4] [--steps 30 300] [--processes 0]

Task T1 on level L1 without cameras, with the two of 128 x 128 px, and with the truth; resets count. ``new episode``
makes an Episode for each trial, which records, with the same card; ``cold`` is an environment that keeps no world;
``warm`` one whose worlds are all kept. Persons have settled before, as after the first trial of a machine. With
``--processes``, as many environments step together as well (``make_vec``).
"""

from __future__ import annotations

import argparse
import json
import os
import time

import mujoco
import numpy as np

from carecontact.episode.episode import Episode
from carecontact.interface.learned import LearnedActions
from carecontact.learn import Bathing, BathingState, make_vec
from carecontact.learn.persons import training_spec

CAMERAS = ("overhead", "wrist")
DOWN = np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0, -1.0], np.float32)
UP = DOWN * [1, 1, -1, 1, 1, 1, 1]
KINDS = {"no cameras": (Bathing, ()), "two cameras of 128 px": (Bathing, CAMERAS), "state": (BathingState, ())}


def row(number: int) -> np.ndarray:
    """Down and up again, without touching."""
    return (DOWN, UP)[number // 20 % 2]


def new_episodes(env: Bathing, persons: int, steps: int) -> None:
    for person in range(persons):
        with Episode(training_spec(env.protocol, "T1", person), card=env.card) as episode:
            rows = LearnedActions(episode.session.action_bounds)
            rows.begin(episode.reset())
            for number in range(steps):
                episode.step(rows.action(row(number)))


def episodes(env: Bathing, persons: int, steps: int) -> None:
    for person in range(persons):
        env.reset(seed=person, options={"person": person})
        for number in range(steps):
            env.step(row(number))


def rate(call: object, *arguments: object, steps: int) -> dict[str, float]:
    began, worked = time.perf_counter(), time.process_time()
    call(*arguments)  # type: ignore[operator]
    wall, cpu = time.perf_counter() - began, time.process_time() - worked
    return {"steps_a_second": round(steps / wall, 1), "cpu_ms_a_step": round(1e3 * cpu / steps, 2)}


def measured(kind: str, persons: int, steps: int) -> dict[str, object]:
    cls, cameras = KINDS[kind]
    cold, warm = (cls("T1", "L1", persons, cameras=cameras, worlds=kept) for kept in (0, persons))
    total = persons * steps
    episodes(warm, persons, 1)
    out: dict[str, object] = {
        "new episode": rate(new_episodes, warm, persons, steps, steps=total),
        "cold": rate(episodes, cold, persons, steps, steps=total),
        "warm": rate(episodes, warm, persons, steps, steps=total),
    }
    cold.close()
    warm.close()
    return out


def together(kind: str, processes: int, steps: int) -> dict[str, float]:
    cls, cameras = KINDS[kind]
    name = "-State" if cls is BathingState else ""
    vector = make_vec(f"carecontact/Bathing-T1-L1{name}-v0", processes, persons=processes, cameras=cameras)
    vector.reset(seed=0)
    vector.step(np.tile(DOWN, (processes, 1)))
    began = time.perf_counter()
    for number in range(steps):
        vector.step(np.tile(row(number), (processes, 1)))
    wall = time.perf_counter() - began
    vector.close()
    return {"processes": processes, "steps_a_second": round(processes * steps / wall, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--persons", type=int, default=4)
    parser.add_argument("--steps", type=int, nargs="+", default=[30, 300])
    parser.add_argument("--processes", type=int, default=0)
    arguments = parser.parse_args()
    load = round(os.getloadavg()[0], 1)
    out: dict[str, object] = {"mujoco": mujoco.__version__, "cores": os.cpu_count(), "load_before": load}
    for steps in arguments.steps:
        rows: dict[str, object] = {}
        for kind in KINDS:
            rows[kind] = measured(kind, arguments.persons, steps)
            if arguments.processes:
                rows[kind] |= {"together": together(kind, arguments.processes, steps)}  # type: ignore[operator]
        out[f"{steps} steps a trial"] = rows
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
