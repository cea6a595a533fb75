"""Time of what an observation is made of, as JSON on standard output.

    python benchmarks/observation.py [--repeat 50]

Overhead camera, 640 x 480, person and robot in view, median of ``--repeat`` in milliseconds of wall clock and of this
process's CPU time over all of its threads: the renderer draws on as many cores as it finds, and on a shared machine
the wall clock says how busy that is. Ends with status 1 if anything was rendered that no card requests.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable

import mujoco
import numpy as np

from carecontact.interface.observation import MODALITIES
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.sensing.builder import IMAGES_FOR, ObservationBuilder
from carecontact.sensing.keypoints import MediaPipePose
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=50)
    arguments = parser.parse_args()
    protocol = load_protocol()
    simulation = Simulation(build_scene(protocol, target="forearm"))
    simulation.settle(52.5)
    data = simulation.data
    mujoco.mj_forward(simulation.model, data)
    out: dict[str, object] = {
        "mujoco": mujoco.__version__, "cores": os.cpu_count(), "load_before": round(os.getloadavg()[0], 1),
        "aim_wall_ms": AIM_MS, "repeat": arguments.repeat,
    }  # fmt: skip
    surplus: dict[str, dict[str, int]] = {}
    keypoints = MediaPipePose()
    with SceneRenderer(simulation.model, protocol=protocol) as renderer:
        angles = renderer.proprioception.joint_position(data)
        calls: dict[str, Callable[[], object]] = {
            "rgb": lambda: renderer.rgb(data, "overhead"),
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
