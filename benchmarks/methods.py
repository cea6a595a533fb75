"""Time of the evaluated methods, as JSON on standard output.

    python benchmarks/methods.py [--policies state-machine,voxposer,voxposer-phased] [--tasks T1] [--without-trials]

One voxposer planning call (maps composed by programs in the sandbox, costs, path) on a real first observation: median
of ``--repeat``, in wall clock and in CPU time of this process; the sandbox's own is some milliseconds more. Then whole
trials, one at a time, in wall clock and in CPU seconds of all their processes: on a shared machine only these say much.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from carecontact.episode.episode import first_look
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.policies.voxposer.policy import VoxPoser
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from some_session import SESSION

AIM = {"voxposer_planning_call_s": 2.0, "140_trials_min": {"state-machine": 10, "voxposer": 25}}
TRIALS, CORES = 140, 2


def planning_call(protocol: Protocol, task: str, repeat: int) -> dict[str, object]:
    policy = VoxPoser()
    card: PolicyCard = policy.card
    observation = first_look(protocol, task_id=task, seed=0, card=card)
    policy.configure(_session(protocol))
    first, calls = [], []
    for _ in range(repeat):
        policy.reset(protocol.task(task).prompt)
        first.append(_timed(lambda: policy.act(observation)))
        calls.append(_timed(lambda: policy.act(observation)))
    return {"task": task, "repeat": repeat, "first_with_all_programs": _median(first), "each_later": _median(calls)}


def whole_trial(policy: str, task: str) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "carecontact", "run", "--policy", policy, "--tasks", task]
        began, before = time.perf_counter(), _children_cpu()
        subprocess.run([*command, "--seeds", "0", "--jobs", "1", "--out", folder], check=True, capture_output=True)
        wall, cpu = time.perf_counter() - began, _children_cpu() - before
        (trial,) = json.loads((Path(folder) / "results.json").read_text())["trials"]
    return {
        "policy": policy, "task": task, "simulated_s": round(trial["duration_s"], 1), "wall_s": round(wall, 1),
        "cpu_s": round(cpu, 1), "c3_success": trial["c3_success"],
    }  # fmt: skip


def _session(protocol: Protocol) -> Session:
    sizes = {name: (camera.width, camera.height) for name, camera in protocol.cameras.items()}
    return replace(SESSION, action_bounds=protocol.impedance.action_bounds, camera_sizes_px=sizes)


def _timed(call: Callable[[], object]) -> tuple[float, float]:
    began, worked = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - began, time.process_time() - worked


def _median(times: list[tuple[float, float]]) -> dict[str, float]:
    wall, cpu = np.median(np.array(times), axis=0)
    return {"wall_s": round(float(wall), 3), "cpu_s": round(float(cpu), 3)}


def _children_cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policies", default="state-machine,voxposer,voxposer-phased")
    parser.add_argument("--tasks", default="T1,T2,T3")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--without-trials", action="store_true")
    arguments = parser.parse_args()
    protocol, tasks = load_protocol("bathing-v3"), arguments.tasks.split(",")
    out: dict[str, object] = {
        "cores": os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 1),
        "aim": AIM,
        "planning": [planning_call(protocol, task, arguments.repeat) for task in tasks],
    }
    if not arguments.without_trials:
        trials = [whole_trial(policy, task) for policy in arguments.policies.split(",") for task in tasks]
        out["trials"] = trials
        out["140_trials_on_2_idle_cores_min"] = {
            policy: round(np.mean([t["cpu_s"] for t in trials if t["policy"] == policy]) * TRIALS / CORES / 60, 1)
            for policy in arguments.policies.split(",")
        }
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
