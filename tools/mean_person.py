"""Write the mean person of the blind baseline ``mean-person`` from a protocol's development seeds.

    python tools/mean_person.py --protocol bathing-v3 --seeds 0-19
    python tools/mean_person.py --protocol bathing-wide-v2 --level L2 --seeds 0-26 --out mean-person.json

The true geometry of every region is read where the person has settled, at each task's own world; nothing is rendered.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np

from carecontact.episode.randomization import settled_world
from carecontact.oracle.truth import Truth
from carecontact.policies import mean_person
from carecontact.policies.mean_person import MeanPerson, MeanRegion
from carecontact.policies.state_machine import travel_height
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.runs.plan import parse_seeds
from carecontact.sim.simulation import Simulation

CAMERA = "overhead"
SHARES = np.linspace(-0.8, 0.8, 17)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", required=True)
    parser.add_argument("--level", default="", help="level of a protocol that has several")
    parser.add_argument("--seeds", default="all")
    shipped = Path(mean_person.__file__).parent / "data" / "mean_person"
    parser.add_argument("--out", type=Path, default=shipped / mean_person.FILE)
    given = parser.parse_args()
    protocol = load_protocol(given.protocol, level=given.level) if given.level else load_protocol(given.protocol)
    seeds = parse_seeds(given.seeds, protocol=protocol)
    first_task = {task.region: task.id for task in reversed(protocol.tasks)}
    regions = {
        region: mean_of([seen(protocol, task, region, seed) for seed in seeds]) for region, task in first_task.items()
    }
    found = MeanPerson(
        made_by="tools/mean_person.py", protocol=protocol.title, protocol_sha256=protocol.sha256, seeds=tuple(seeds),
        camera=CAMERA, regions=regions,
    )  # fmt: skip
    given.out.write_text(found.model_dump_json(indent=1) + "\n")
    print(f"{len(regions)} regions of {len(seeds)} persons: {given.out}")


def seen(protocol: Protocol, task_id: str, region: str, seed: int) -> dict[str, np.ndarray]:
    """One person's region in the camera's frame, as numbers that can be averaged."""
    simulation, _, _ = settled_world(protocol, task_id=task_id, seed=seed)
    simulation.refresh()
    truth = Truth(simulation, region)
    geometry, camera = truth.geometry(), camera_in_base(simulation)
    start = simulation.encoders.pose_tcp_in_base(simulation.data)[:3, 3]
    support = geometry.support_height_m
    distances, heights = geometry.profile_m.T
    numbers = {
        "centre": camera[:3, :3].T @ (geometry.centre_m - camera[:3, 3]),
        "axis": camera[:3, :3].T @ geometry.axis,
        "radius": geometry.radius_m,
        "half": geometry.half_length_m,
        "heights": np.interp(SHARES * geometry.half_length_m, distances, heights),
        "support": np.nan if support is None else geometry.centre_m[2] - support,
        "over": travel_height(truth.skin(), start, geometry.centre_m) - geometry.centre_m[2],
    }
    return {name: np.asarray(value, np.float64) for name, value in numbers.items()}


def camera_in_base(simulation: Simulation) -> np.ndarray:
    """(4, 4) where the camera really stands."""
    data, number = simulation.data, mujoco.mj_name2id(simulation.model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    return simulation.encoders.in_base(data, data.cam_xpos[number], data.cam_xmat[number].reshape(3, 3) @ OPENCV)


OPENCV = np.diag([1.0, -1.0, -1.0])
"""From OpenCV's axes of a camera to MuJoCo's."""


def mean_of(persons: list[dict[str, np.ndarray]]) -> MeanRegion:
    mean = {name: np.mean([one[name] for one in persons], 0) for name in persons[0]}
    half = float(mean["half"])
    return MeanRegion(
        centre_in_camera=tuple(mean["centre"].round(5)),
        axis_in_camera=tuple(mean["axis"].round(5)),
        radius_m=round(float(mean["radius"]), 5),
        half_length_m=round(half, 5),
        profile_m=tuple(zip((SHARES * half).round(5), mean["heights"].round(5), strict=True)),
        support_under_m=None if np.isnan(mean["support"]) else round(float(mean["support"]), 5),
        way_over_m=round(float(max(one["over"] for one in persons)), 5),
    )


if __name__ == "__main__":
    main()
