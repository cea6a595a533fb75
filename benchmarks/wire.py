"""Time of one request over loopback to a served policy, as JSON on standard output: medians and 95th percentiles [ms].

    python benchmarks/wire.py [--repeat 300]

``openpi``: two pictures of 224 x 224 pixels and the robot's state to examples/openpi_server.py, which runs in a process
of its own, and a chunk of fifteen actions back, with every check of ours. ``openpi_with_resizing``: the same from
pictures as the cameras of bathing-v3 have them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from carecontact.interface.observation import CameraView, Observation
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import open_policy
from some_session import SESSION, observation

SERVER = Path(__file__).parents[1] / "examples" / "openpi_server.py"


def seen(sizes_hw: dict[str, tuple[int, int]]) -> Observation:
    noise = np.random.default_rng(0)
    cameras = {
        name: CameraView(
            intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=noise.integers(0, 255, (*hw, 3)).astype(np.uint8)
        )
        for name, hw in sizes_hw.items()
    }
    return observation(cameras)


def round_trips(port: int, seen: Observation, repeat: int) -> dict[str, float]:
    setup = PolicySetup.of(f"openpi://127.0.0.1:{port}?profile=pi05-droid")
    took: list[float] = []
    with open_policy(setup, first_deadline_s=30.0, deadline_s=30.0) as policy:
        policy.start()
        policy.reset(seen.instruction, SESSION)
        for _ in range(repeat):
            began = time.perf_counter()
            policy.act(seen)
            took.append(1000 * (time.perf_counter() - began))
    return {"median_ms": round(float(np.median(took)), 2), "p95_ms": round(float(np.percentile(took, 95)), 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=300)
    repeat = parser.parse_args().repeat
    command = [sys.executable, str(SERVER), "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        port = int(server.stdout.readline().split()[-1])
        # It prints a line for each request, which somebody has to take.
        threading.Thread(target=server.stdout.read, daemon=True).start()
        ready, cameras = {"exterior": (224, 224), "wrist": (224, 224)}, {"exterior": (360, 640), "wrist": (480, 640)}
        found = {
            "openpi": round_trips(port, seen(ready), repeat),
            "openpi_with_resizing": round_trips(port, seen(cameras), repeat),
        }
        server.kill()
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
