"""Cost of a large tool under the robot, beside the cap's, as JSON on standard output.

    python benchmarks/pad.py [--newton 10 20] [--regions forearm abdomen] [--protocol NAME]

A box of 30 x 40 x 12 mm lies where the cap was, its face in the tool centre point. Both scrub the region, the arm held,
as in the check ``smoothness`` of ``carecontact verify physics``. The time is that of all that a control period does, in
CPU seconds of this process.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time

import mujoco
import numpy as np

from carecontact.interface.robot import PANDA
from carecontact.lab.validation.passive_response import lock_arm
from carecontact.lab.validation.rig import PAD
from carecontact.lab.validation.smoothness import scrub
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.load import load_protocol
from carecontact.world.scene import Scene, build_scene

REGIONS = ("forearm", "upper_arm", "abdomen")
STROKES, RUNS = 4, 2


def with_pad(*args: object, **options: object) -> Scene:
    """The scene whose hand has the pad in the cap's place."""
    scene = build_scene(*args, **options)  # pyright: ignore[reportArgumentType]
    model = scene.model
    geom = model.geom(PANDA.tip.geom).id
    model.geom_type[geom] = PAD.kind
    model.geom_size[geom] = PAD.size_m
    model.geom_pos[geom] = [0, 0, PANDA.tcp_z_m - PAD.height_m]
    model.geom_aabb[geom] = [0, 0, 0, *PAD.size_m]
    model.geom_rbound[geom] = np.linalg.norm(PAD.size_m)
    return scene


def measured(subject: Subject, region: str, newton: float) -> dict[str, float | int | list[str]]:
    best = np.inf
    for _ in range(RUNS):
        simulation = subject.hovering(region)
        lock_arm(simulation)
        start = time.process_time()
        made = scrub(simulation, newton, strokes=STROKES, region=region)
        best = min(best, time.process_time() - start)
    steps = simulation.data.time / simulation.model.opt.timestep
    row = simulation.tissue[region].last(simulation.data, 1)[0]
    return {
        "us_per_step": round(1e6 * best / steps, 1),
        "mean_force_at_speed_n": round(float(made.force_n[made.steady].mean()), 1),
        "share_at_speed": round(float(made.steady.mean()), 2),
        "points_at_the_end": int(row["points"]),
        "warnings": list(simulation.solver_warnings()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--newton", type=float, nargs="+", default=[10.0, 20.0])
    parser.add_argument("--regions", nargs="+", default=REGIONS, choices=REGIONS)
    parser.add_argument("--protocol", help="default: the main protocol")
    arguments = parser.parse_args()
    protocol, rows = load_protocol(*([arguments.protocol] if arguments.protocol else [])), []
    cap, pad = Subject(protocol), Subject(protocol, make_scene=with_pad)
    for region in arguments.regions:
        for newton in arguments.newton:
            of_cap, of_pad = (measured(subject, region, newton) for subject in (cap, pad))
            ratio = of_pad["us_per_step"] / of_cap["us_per_step"]  # pyright: ignore[reportOperatorIssue]
            rows.append(
                {"region": region, "newton": newton, "pad_over_cap": round(ratio, 2), "cap": of_cap, "pad": of_pad}
            )
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    print(json.dumps({"mujoco": mujoco.__version__, "load": os.getloadavg()[0], "scrubs": rows}, indent=2))


if __name__ == "__main__":
    main()
