"""Speed of the physics, of a whole trial and of the command line, as JSON on standard output.

    python benchmarks/speed.py [--protocol NAME] [--task T3] [--without-trial]
                               [--before CHECKOUT] [--protocol-before NAME]

Timings on a shared machine wander: physics is the best of several batches in CPU seconds of this process, and the ratio
of contact to rest is taken in the same run. ``--before`` measures the physics of another checkout of this project in
turn with this one's, so that old and new stand beside each other; with ``--protocol-before``, which may differ from
``--protocol``, this checkout can also stand beside itself. Physics is measured at the protocol's step and in the
fast mode, with the share of each stage of a step in contact: what limits it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.regions import REGIONS as REGION_ROWS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import FAST_DT_S, overridden
from carecontact.protocol.protocol import Protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene

BATCHES, BATCH_STEPS, SCRUB_STROKES = 8, 250, 6
REGIONS = ("forearm", "upper_arm", "abdomen")
DOWN = np.array([0.0, 1.0, 0.0, 0.0])


def microseconds_per_step(simulation: Simulation) -> float:
    best = np.inf
    for _ in range(BATCHES):
        start = time.process_time()
        simulation.advance(BATCH_STEPS)
        best = min(best, (time.process_time() - start) / BATCH_STEPS)
    return round(best * 1e6, 1)


def press(simulation: Simulation, region: str) -> tuple[float, np.ndarray]:
    """Bring the tool onto the region at about 10 N; returns the force [N] and the tool's place (3,) in the world."""
    model, data, felt = simulation.model, simulation.data, simulation.tissue[region]
    skin = felt.vertices(data) @ data.xmat[felt.bone].reshape(3, 3).T + data.xpos[felt.bone]
    middle = data.site(f"region_{region}").xpos.copy()
    top = skin[np.linalg.norm(skin[:, :2] - middle[:2], axis=1) < 0.02][:, 2].max()
    for height, seconds in ((0.12, 4.0), (-0.035, 3.0)):
        go(simulation, np.array([*middle[:2], top + height]), seconds)
        simulation.advance(round((seconds + 0.5) / model.opt.timestep))
    force = simulation.advance(10)[-1].force[-1, SEGMENTS.index(REGION_ROWS[region].segment)]
    return float(np.linalg.norm(force)), np.array([*middle[:2], top - 0.035])


def go(simulation: Simulation, place: np.ndarray, seconds: float) -> None:
    base = simulation.pose_base_in_world
    simulation.set_goal(np.r_[matrix_from_quat(base[3:]).T @ (place - base[:3]), DOWN], seconds)


def scrub(simulation: Simulation, region: str, place: np.ndarray) -> float:
    """Microseconds a step while the tool goes to and fro along the region at 0.1 m/s, through ``advance``."""
    along = simulation.data.site(f"region_{region}").xmat.reshape(3, 3)[:, 0].copy()
    best = np.inf
    for stroke in range(SCRUB_STROKES):
        go(simulation, place + along * (0.05 if stroke % 2 else -0.05), 1.0)
        steps = round(1.0 / simulation.model.opt.timestep)
        start = time.process_time()
        simulation.advance(steps)
        # The first is half as long: it starts from the middle.
        best = min(best, (time.process_time() - start) / steps) if stroke else best
    return round(best * 1e6, 1)


def physics(protocol: Protocol, region: str) -> dict[str, object]:
    start = time.perf_counter()
    scene = build_scene(protocol, target=region)
    built = time.perf_counter()
    simulation = Simulation(scene)
    simulation.settle(52.5)
    settled = time.perf_counter()
    simulation.start()
    rest = microseconds_per_step(simulation)
    force, place = press(simulation, region)
    contact = microseconds_per_step(simulation)
    stages = stage_shares(simulation)
    scrubbing = scrub(simulation, region, place)
    dt = scene.model.opt.timestep
    return {
        "region": region, "dt_s": dt, "dofs": scene.model.nv,
        "shell_vertices": {name: len(r.shell.vertices) for name, r in scene.regions.items()},
        "build_wall_s": round(built - start, 2), "settle_wall_s": round(settled - built, 2), "force_n": round(force, 1),
        "us_per_step_rest": rest, "us_per_step_contact": contact, "contact_over_rest": round(contact / rest, 2),
        "real_time_factor_contact": round(dt * 1e6 / contact, 2), "us_per_step_scrub": scrubbing,
        "real_time_factor_scrub": round(dt * 1e6 / scrubbing, 2), "stages_in_contact": stages,
    }  # fmt: skip


STAGES = {
    "kinematics": ("mjTIMER_POS_KINEMATICS",), "inertia": ("mjTIMER_POS_INERTIA",),
    "collision": ("mjTIMER_POS_COLLISION",), "making constraints": ("mjTIMER_POS_MAKE", "mjTIMER_POS_PROJECT"),
    "velocity and tissue": ("mjTIMER_VELOCITY",), "constraint solver": ("mjTIMER_CONSTRAINT",),
    "integration": ("mjTIMER_ADVANCE",),
}  # fmt: skip


def stage_shares(simulation: Simulation) -> dict[str, float]:
    """Share of each stage in the wall time of a step."""
    data, steps = simulation.data, 200
    mujoco.set_mjcb_time(time.perf_counter)
    try:
        for timer in data.timer:
            timer.duration = 0.0
        simulation.advance(steps)
        spent = {
            name: data.timer[int(getattr(mujoco.mjtTimer, name))].duration for row in STAGES.values() for name in row
        }
        total = data.timer[int(mujoco.mjtTimer.mjTIMER_STEP)].duration
    finally:
        mujoco.set_mjcb_time(None)
    return {stage: round(sum(spent[name] for name in row) / total, 3) for stage, row in STAGES.items()}


def beside(checkout: Path, protocols: dict[str, str | None]) -> list[dict[str, object]]:
    """Physics of another checkout and of this one, region by region in turn, each in a process of its own."""
    rows = []
    for region in REGIONS:
        pair = {}
        for name, root in (("before", checkout), ("now", Path(__file__).resolve().parents[1])):
            asked = "" if protocols[name] is None else repr(protocols[name])
            code = (
                f"import sys; sys.path.insert(0, {str(root / 'benchmarks')!r}); import json, speed; "
                f"print(json.dumps(speed.physics(speed.load_protocol({asked}), {region!r})))"
            )
            environment = {**os.environ, "PYTHONPATH": str(root / "src")}
            done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, env=environment)
            pair[name] = json.loads(done.stdout)
        ratio = pair["before"]["us_per_step_contact"] / pair["now"]["us_per_step_contact"]
        scrubs = pair["before"]["us_per_step_scrub"] / pair["now"]["us_per_step_scrub"]
        ratios = {"before_over_now_in_contact": round(ratio, 2), "before_over_now_in_scrub": round(scrubs, 2)}
        rows.append({"region": region, **ratios, **pair})
    return rows


def whole_trial(task: str, protocol: Protocol) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "carecontact", "run", "--policy", "state-machine", "--tasks", task]
        command += ["--protocol", protocol.id]
        start = time.perf_counter()
        subprocess.run([*command, "--seeds", "0", "--jobs", "1", "--out", folder], check=True, capture_output=True)
        wall = time.perf_counter() - start
        score = json.loads((Path(folder) / "results.json").read_text())
    simulated = next(t["duration_s"] for t in score["trials"])
    return {"task": task, "simulated_s": simulated, "wall_s_with_scores_and_report": round(wall, 2)}


def help_seconds() -> float:
    times = []
    for _ in range(5):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "carecontact", "--help"], check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return round(min(times), 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--protocol", help="of all measurements (default: the main protocol)")
    parser.add_argument("--task", default="T3", help="task of the whole trial")
    parser.add_argument("--without-trial", action="store_true")
    parser.add_argument("--before", type=Path, help="another checkout to measure beside this one")
    parser.add_argument("--protocol-before", help="of the other checkout's physics (default: as --protocol)")
    arguments = parser.parse_args()
    protocol = load_protocol(*([arguments.protocol] if arguments.protocol else []))
    out: dict[str, object] = {
        "mujoco": mujoco.__version__,
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "physics": [physics(protocol, region) for region in REGIONS],
        "physics_fast": [physics(overridden(protocol, {"physics.dt_s": FAST_DT_S}), region) for region in REGIONS],
        "help_s": help_seconds(),
    }
    if arguments.before:
        before = arguments.protocol_before or arguments.protocol
        out["beside"] = beside(arguments.before.resolve(), {"before": before, "now": arguments.protocol})
    if not arguments.without_trial:
        out["trial"] = whole_trial(arguments.task, protocol)
    print(json.dumps(out, indent=2))


if __name__ == "__main__":
    main()
