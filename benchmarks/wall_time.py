"""How well a policy can tell contact from the wall time between two acts, with and without a pace, as JSON.

    python benchmarks/wall_time.py [--pace 0.4] [--tasks T1,T3,T5,T7] [--cameras overhead] [--load 0] [--shuffled 0]

The state machine's actions are played again one by one, by a policy in a process of its own that notes when it answers
and when its next observation comes: it measures what any local policy can, to the microsecond. For each run: the area
under the curve (AUC) of that time per control period against contact, within each trial, from the policy's own clock
and from the times that the recordings hold; and, for the policy's, the medians with and without contact [ms].
``--load`` keeps so many cores busy beside the run.

A trial touches in one stretch, so that anything else that slows the machine for a while looks like contact, or hides
it. ``--shuffled N`` therefore leaves the simulator out: the policy answers N observations of a camera, and between them
the harness computes for 0.07 or 0.15 s of wall time, in random order.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from carecontact.audit.wall_time import Separation, Times, separation, times_of
from carecontact.interface.action import MAX_CHUNK
from carecontact.interface.observation import CameraView
from carecontact.protocol.load import load_protocol
from carecontact.recording import Recording, read_recording
from carecontact.running.pace import PACED, Pace
from carecontact.running.supervisor import run_trials
from carecontact.runs.plan import parse_tasks, plan_trials
from carecontact.serving.codec import act_message
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import open_policy
from some_session import SESSION, observation

POLICY = """
import json, os, time
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class OneByOne:
    def __init__(self, *, folder: str, cameras: str):
        given = tuple(name for name in cameras.split(",") if name)
        self.card = PolicyCard(name="one-by-one", modalities=("rgb",) if given else (), cameras=given)
        self.folder, self.acts = folder, 0
    def reset(self, instruction):
        with open(os.path.join(self.folder, "actions.json")) as file:
            name, self.actions = json.load(file)[instruction]
        self.notes = open(os.path.join(self.folder, f"{name}.jsonl"), "w")
    def act(self, observation):
        came = time.perf_counter()
        pose, stiffness = self.actions[self.acts]
        self.acts += 1
        target = None if pose is None else np.array(pose)
        action = Action(pose_tcp_in_base=target, stiffness=tuple(stiffness), done=self.acts == len(self.actions))
        print(json.dumps([came, time.perf_counter()]), file=self.notes, flush=True)
        return action
"""


def actions_of(recording: Recording) -> list[tuple[list[float] | None, list[float]]]:
    poses, stiffness = recording["actions/pose_tcp_in_base"], recording["actions/stiffness"]
    kept = [None if np.isnan(pose).any() else pose.tolist() for pose in poses]
    return list(zip(kept, stiffness.tolist(), strict=True))[:MAX_CHUNK]


def rounded(found: Separation) -> dict[str, float]:
    return {"auc": round(found.auc, 3), "standard_errors": round(found.z, 1)}


def measured(folder: Path, notes: Path) -> dict[str, object]:
    """Of the trials in ``folder``, whose policy wrote into ``notes``."""
    seen: list[Times] = []
    kept: list[Times] = []
    late = 0
    for path in sorted(folder.glob("*.h5")):
        recording = read_recording(path)
        times = times_of(recording)
        kept.append(times)
        late += int(recording.arrays.get("wall/pace", np.zeros(2))[1])
        lines = (notes / f"{recording.header.spec.task_id}.jsonl").read_text().splitlines()
        came, left = np.array([json.loads(line) for line in lines]).T
        seen.append(replace(times, per_period_s=(came[1:] - left[:-1])[: len(times.contact)]))
    both = {
        word: np.concatenate([t.per_period_s[t.contact == yes] for t in seen])
        for word, yes in (("contact", True), ("no contact", False))
    }
    return {
        "policy": rounded(separation(seen)),
        "recording": rounded(separation(kept)),
        "late": late,
        "intervals": {word: len(values) for word, values in both.items()},
        "median_ms": {word: round(1000 * float(np.median(values)), 3) for word, values in both.items()},
        "p95_ms": {word: round(1000 * float(np.percentile(values, 95)), 3) for word, values in both.items()},
    }


def compute(seconds: float) -> None:
    """Keep the core and its caches busy for so much wall time."""
    until, work = time.perf_counter() + seconds, np.ones(1 << 18)
    while time.perf_counter() < until:
        work = np.sqrt(work * work + 1e-9)


def shuffled(count: int, folder: Path, *, pace_s: float | None) -> dict[str, float]:
    """What the policy's clock tells of how long was computed before each observation, in random order."""
    chance = np.random.default_rng(0)
    picture = chance.integers(0, 255, (480, 640, 3)).astype(np.uint8)
    camera = CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=picture)
    seen = observation({"overhead": camera})
    (folder / "one_by_one.py").write_text(POLICY)
    (folder / "actions.json").write_text(json.dumps({"shuffled": ("shuffled", [(None, (400.0, 20.0))] * (count + 1))}))
    setup = PolicySetup.of(
        "one_by_one:OneByOne", search_path=[str(folder)], arguments={"folder": str(folder), "cameras": "overhead"}
    )
    setup, pace, long = replace(setup, writable=(str(folder),)), Pace(pace_s), chance.random(count) < 0.5
    with open_policy(setup, first_deadline_s=60.0, deadline_s=60.0) as policy:
        policy.start()
        policy.reset("shuffled", SESSION)
        policy.act(seen)
        for each in long:
            pace.answered(1)
            compute(0.15 if each else 0.07)
            pace.hold(partial(act_message, seen))
            policy.act(seen)
    came, left = np.array([json.loads(line) for line in (folder / "shuffled.jsonl").read_text().splitlines()]).T
    late = {"late": float(pace.arrays()[PACED][1])} if pace_s is not None else {}
    return rounded(separation([Times(per_period_s=came[1:] - left[:-1], contact=long)])) | late


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pace", type=float, default=0.4)
    parser.add_argument("--tasks", default="T1,T3,T5,T7")
    parser.add_argument("--cameras", default="overhead")
    parser.add_argument("--load", type=int, default=0)
    parser.add_argument("--shuffled", type=int, default=0, metavar="N")
    given = parser.parse_args()
    protocol = load_protocol("bathing-v3")
    tasks = parse_tasks(given.tasks, protocol=protocol)
    found: dict[str, object] = {"pace_s": given.pace, "tasks": tasks, "cameras": given.cameras, "load": given.load}
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(given.load)]
    try:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            if given.shuffled:
                for name, pace_s in (("without", None), ("with", given.pace)):
                    found[name] = shuffled(given.shuffled, folder, pace_s=pace_s)
                tasks = []
            (folder / "notes").mkdir()
            (folder / "one_by_one.py").write_text(POLICY)
            if not tasks:
                sys.stdout.write(json.dumps(found, indent=2) + "\n")
                return
            first = plan_trials(protocol=protocol, policy="state-machine", tasks=tasks, seeds=[0])
            run_trials(first, out=folder / "first", jobs=1)
            made = [read_recording(folder / "first" / f"{spec.trial_id}.h5") for spec in first]
            prompts = {
                protocol.task(r.header.spec.task_id).prompt: (r.header.spec.task_id, actions_of(r)) for r in made
            }
            (folder / "notes" / "actions.json").write_text(json.dumps(prompts))
            arguments = {"folder": str(folder / "notes"), "cameras": given.cameras}
            setup = PolicySetup.of("one_by_one:OneByOne", search_path=[place], arguments=arguments)
            setup = replace(setup, writable=(str(folder / "notes"),))
            again = plan_trials(protocol=protocol, policy=setup.ref.text, tasks=tasks, seeds=[0], arguments=arguments)
            for name, pace_s in (("without", None), ("with", given.pace)):
                run_trials(again, out=folder / name, policy=setup, jobs=1, pace_s=pace_s)
                found[name] = measured(folder / name, folder / "notes")
    finally:
        for process in busy:
            process.kill()
            process.wait()
    sys.stdout.write(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
