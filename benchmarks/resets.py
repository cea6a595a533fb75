"""Time and memory of episodes that begin again, beside new ones, as JSON on standard output.

    python benchmarks/resets.py [--seeds 6] [--repeat 20]

Protocol bathing-wide-v2, level L1, tasks T1 and T4: median milliseconds of wall clock and of this process's CPU
time over all of its threads. ``new`` is a new Episode with its first observation; ``another trial`` the same trial on
an object that had another one before; ``kept`` a trial whose world the object has kept. Persons have settled before, as
after the first trial of a machine. Each is measured without cameras and with the two of 128 x 128 px.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterable

import mujoco
import numpy as np
import psutil

from carecontact.episode.episode import Episode
from carecontact.episode.worlds import Worlds
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec

TASKS = ("T1", "T4")
PX = 128
CAMERAS = ("overhead", "wrist")


def median_ms(calls: Iterable[Callable[[], object]]) -> dict[str, float]:
    wall, cpu = [], []
    for call in calls:
        began, worked = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - began)
        cpu.append(time.process_time() - worked)
    return {"wall_ms": round(1e3 * float(np.median(wall)), 1), "cpu_ms": round(1e3 * float(np.median(cpu)), 1)}


def resident_mib() -> float:
    return psutil.Process().memory_info().rss / 2**20


def measured(specs: list[TrialSpec], card: PolicyCard, repeat: int) -> dict[str, object]:
    def new(spec: TrialSpec) -> None:
        with Episode(spec, card=card) as episode:
            episode.reset()

    for spec in specs:
        new(spec)
    out: dict[str, object] = {"new": median_ms(lambda spec=spec: new(spec) for spec in specs)}
    worlds, before = Worlds(len(specs)), resident_mib()
    with Episode(specs[0], card=card, worlds=worlds, record=False) as episode:
        out["another trial"] = median_ms(lambda spec=spec: episode.reset(spec) for spec in specs[1:])
        out["MiB a kept world"] = round((resident_mib() - before) / len(specs), 1)
        out["kept"] = median_ms(lambda spec=spec: episode.reset(spec) for spec in specs * repeat)
        out["kept, the same again"] = median_ms(episode.reset for _ in range(repeat))
        out["step"] = median_ms(lambda: episode.step(Action()) for _ in range(repeat))
        episode.privileged = True
        episode.reset()
        for _ in range(5 * repeat):
            episode.step(Action(), observe=False)
        out["progress"] = median_ms(episode.progress for _ in range(repeat))
    worlds.clear()
    with Episode(specs[0], card=card) as episode:
        episode.reset()
        out["step that is recorded"] = median_ms(lambda: episode.step(Action()) for _ in range(repeat))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--repeat", type=int, default=20)
    arguments = parser.parse_args()
    small = {f"cameras.{name}.{side}": PX for name in CAMERAS for side in ("width", "height")}
    protocol = overridden(load_protocol("bathing-wide-v2", level="L1"), small)
    specs = [
        TrialSpec(protocol=protocol, task_id=task, seed=seed, policy="benchmark")
        for seed in range(arguments.seeds)
        for task in TASKS
    ]
    cards = {
        "no cameras": PolicyCard(name="benchmark", cameras=(), control_hz=10),
        f"two cameras of {PX} px": PolicyCard(name="benchmark", modalities=("rgb",), cameras=CAMERAS, control_hz=10),
    }
    out: dict[str, object] = {
        "mujoco": mujoco.__version__, "cores": os.cpu_count(), "load_before": round(os.getloadavg()[0], 1),
        "trials": len(specs), "repeat": arguments.repeat,
    }  # fmt: skip
    out |= {name: measured(specs, card, arguments.repeat) for name, card in cards.items()}
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
