"""Time of what an observation is made of, as JSON on standard output.

    python benchmarks/observation.py [--repeat 50] [--trials [--parent CLONE]]

Overhead camera, 640 x 480, person and robot in view, median of ``--repeat`` in milliseconds of wall clock and of this
process's CPU time over all of its threads: the renderer draws on as many cores as it finds, and on a shared machine
the wall clock says how busy that is. Ends with status 1 if anything was rendered that no card requests.

``--trials`` measures whole trials instead: 30 s of a policy that holds the arm still and answers one action at 20 Hz,
with a view of every camera for every observation, one a second, and one in all. They are given in seconds of CPU time
of the trial's and the policy's processes. ``--parent`` measures the first of them also in another clone of the
repository, whose cards may know no rates.
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
from pathlib import Path

import mujoco
import numpy as np

from carecontact.episode.randomization import settled_world
from carecontact.interface.observation import MODALITIES
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.running.trial import run_trial
from carecontact.sensing.builder import IMAGES_FOR, ObservationBuilder
from carecontact.sensing.keypoints import PoseEstimator
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene

VIEWS = {"every observation": None, "one a second": 1.0, "one in all": 0.0}
"""How often a camera takes a view -> its rate [Hz]."""
CARDS = {
    "rgb overhead": (("rgb",), ("overhead",)),
    "rgb overhead and wrist": (("rgb",), ("overhead", "wrist")),
    "depth and points overhead": (("depth", "points"), ("overhead",)),
    "everything overhead": (MODALITIES, ("overhead",)),
}
"""What is measured -> modalities and cameras."""
HOLDING = """
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Holding:
    card = PolicyCard(name="holding", **{card!r})
    def reset(self, instruction):
        pass
    def act(self, observation):
        return Action()
"""
AIM_MS = {"rgb": 25.0, "depth": 20.0}


def median_ms(call: Callable[[], object], repeat: int) -> dict[str, float]:
    call()  # makes contexts and caches
    wall, cpu = [], []
    for _ in range(repeat):
        began, worked = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - began)
        cpu.append(time.process_time() - worked)
    return {
        "wall_ms": round(1000 * float(np.median(wall)), 1),
        "least_wall_ms": round(1000 * min(wall), 1),
        "cpu_ms": round(1000 * float(np.median(cpu)), 1),
    }


def trial_cpu_s(card: dict[str, object]) -> float:
    """Return the CPU time [s] of a trial to its time limit, without that of building its world."""
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="holding:Holding")
    world = settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "holding.py").write_text(HOLDING.format(card=card))
        began = _cpu_s()
        setup = PolicySetup.of(spec.policy, search_path=[folder])
        ended = run_trial(spec, policy=setup, prepare=lambda spec: world).header.ended
        assert ended == "time_limit", ended
        return _cpu_s() - began


def _cpu_s() -> float:
    used = [resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def trials(parent: Path | None) -> dict[str, dict[str, float]]:
    """Return the CPU time [s] of a trial for each card and number of views, and the ratio of a view a second to one in
    all.
    """
    out: dict[str, dict[str, float]] = {}
    for name, (modalities, cameras) in CARDS.items():
        card: dict[str, object] = {"modalities": modalities, "cameras": cameras, "control_hz": 20.0}
        row = out[name] = {}
        for views, hz in VIEWS.items():
            if hz is None and "landmarks" in modalities:
                continue  # four minutes
            rates = {} if hz is None else {"camera_hz": dict.fromkeys(cameras, hz)}
            row[views] = round(trial_cpu_s(card | rates), 2)
        row["one a second / one in all"] = round(row["one a second"] / row["one in all"], 2)
        if parent is not None and "every observation" in row:
            call = f"import json, observation; print(json.dumps(observation.trial_cpu_s({card!r})))"
            paths = os.pathsep.join([str(parent / "src"), str(Path(__file__).parent)])
            command, variables = [sys.executable, "-c", call], {**os.environ, "PYTHONPATH": paths}
            done = subprocess.run(command, env=variables, check=True, capture_output=True, text=True)
            row["every observation, parent"] = round(json.loads(done.stdout), 2)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=50)
    parser.add_argument("--trials", action="store_true")
    parser.add_argument("--parent", type=Path)
    arguments = parser.parse_args()
    if arguments.trials:
        print(json.dumps(trials(arguments.parent), indent=2))
        return
    protocol = load_protocol("bathing-v3")
    simulation = Simulation(build_scene(protocol, target="forearm"))
    simulation.settle(52.5)
    data = simulation.data
    mujoco.mj_forward(simulation.model, data)
    out: dict[str, object] = {
        "mujoco": mujoco.__version__, "cores": os.cpu_count(), "load_before": round(os.getloadavg()[0], 1),
        "aim_wall_ms": AIM_MS, "repeat": arguments.repeat,
    }  # fmt: skip
    surplus: dict[str, dict[str, int]] = {}
    keypoints = PoseEstimator()
    with SceneRenderer(simulation.model, protocol=protocol) as renderer:
        angles = renderer.proprioception.joint_position(data)
        calls: dict[str, Callable[[], object]] = {
            "rgb": lambda: renderer.rgb(data, "overhead"),
            "rgb after foam changed": lambda: (renderer.skin_changed(), renderer.rgb(data, "overhead")),
            "depth": lambda: renderer.depth(data, "overhead"),
            "robot_depth": lambda: renderer.robot_depth(angles, "overhead"),
            "truth (scorer)": lambda: renderer.truth(data, "overhead"),
        }
        out["images"] = {name: median_ms(call, arguments.repeat) for name, call in calls.items()}
        observations: dict[str, object] = {}
        for modalities in ((), *((m,) for m in MODALITIES), MODALITIES):
            card = PolicyCard(name="benchmark", modalities=modalities)
            builder = ObservationBuilder(renderer, card, protocol, keypoints)
            before = renderer.renders.copy()
            builder.build(data, instruction="", sim_time_s=0.0)
            name = "+".join(modalities) or "nothing"
            asked = {image for m in modalities for image in IMAGES_FOR[m]}
            unasked = {kind: n for kind, n in (renderer.renders - before).items() if kind not in asked or n > 1}
            if unasked:
                surplus[name] = unasked
            repeat = max(3, arguments.repeat // 10) if {"masks", "landmarks"} & set(modalities) else arguments.repeat
            observations[name] = median_ms(lambda b=builder: b.build(data, instruction="", sim_time_s=0.0), repeat)
        out["observations"] = observations
    out["rendered_unasked"] = surplus
    print(json.dumps(out, indent=2))
    if surplus:
        sys.exit(1)


if __name__ == "__main__":
    main()
