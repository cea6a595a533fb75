"""Trials per minute of this machine, and what a trial costs besides its simulation, as JSON on standard output.

    python benchmarks/suite.py [--trials 8] [--jobs 1 2] [--rounds 1] [--before CHECKOUT]

Trials of the blind policy `zero-action` on T1, cut at one second, so that little but the cost of a trial is left.
``overhead_s`` is the wall time of a trial in a run with one job, less that of the same trial in a process that is warm:
start of the process, imports, supervision and storing. ``overhead_cpu_s`` is the same in processor time, which a busy
machine disturbs less. ``supervision_s`` is what the supervisor adds: its loop, the folder, and a worker that only
copies a recording. ``--before`` measures another checkout of this project in turn with this one, so that old
and new stand beside each other; an environment made for one serves both if they need the same packages.
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
from statistics import median

HERE = Path(__file__).resolve().parents[1]
ASKED = {"policy": "zero-action", "task": "T1", "time_limit_s": 1}

SPECS = """
import json, os, resource, sys, time
from pathlib import Path
from carecontact.protocol.load import load_protocol; from carecontact.protocol.overrides import overridden
from carecontact.runs.plan import plan_trials
rules = overridden(load_protocol("bathing-v3"), {"phases.time_limit_s": %(time_limit_s)d})
def specs(count):
    return plan_trials(protocol=rules, policy="%(policy)s", tasks=["%(task)s"], seeds=range(count))
def cpu_s():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
folder, count, jobs = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
"""
SUITE = """
from carecontact.running.supervisor import run_trials
run_trials(specs(1), out=folder / "first", jobs=1)  # settles the person and fills the caches
began, used = time.perf_counter(), cpu_s()
run_trials(specs(count), out=folder / "suite", jobs=jobs)
print(json.dumps([time.perf_counter() - began, (cpu_s() - used) / count]))
"""
WARM = """
from carecontact.recording import write_recording
from carecontact.running.trial import run_trial
for number, spec in enumerate([*specs(1), *specs(count)]):
    write_recording(run_trial(spec), folder / f"{number}.h5")
    if number == 0:
        began, used = time.perf_counter(), cpu_s()
print(json.dumps([(time.perf_counter() - began) / count, (cpu_s() - used) / count]))
"""
WORKER = """
import json, shutil, sys
asked = json.load(sys.stdin)
shutil.copy("{}/%s-s%03d.h5" % (asked["spec"]["task_id"], asked["spec"]["seed"]), asked["out"])
"""
COPY = f"""
import subprocess
from carecontact.recording import write_recording
from carecontact.running.supervisor import run_trials
from carecontact.running.trial import run_trial
for spec in specs(count):
    write_recording(run_trial(spec), folder / f"{{spec.trial_id}}.h5")
script = folder / "copy.py"
script.write_text({WORKER!r}.replace("{{}}", str(folder)))
command = (sys.executable, "-S", str(script))
began = time.perf_counter()
for spec in specs(count):
    asked = json.dumps({{"spec": {{"task_id": spec.task_id, "seed": spec.seed}}, "out": str(folder / "x.h5")}})
    subprocess.run(command, input=asked, text=True, check=True)
alone = time.perf_counter() - began
began = time.perf_counter()
run_trials(specs(count), out=folder / "copied", jobs=1, worker_command=command)
print(json.dumps([(time.perf_counter() - began - alone) / count]))
"""


def measured(root: Path, code: str, *, trials: int, jobs: int = 1) -> list[float]:
    """What the code of a checkout prints, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(root / "src")}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", SPECS % ASKED + code, folder, str(trials), str(jobs)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    return json.loads(done.stdout.splitlines()[-1])


def suite(root: Path, *, trials: int, jobs: list[int]) -> dict[str, object]:
    runs = {count: measured(root, SUITE, trials=trials, jobs=count) for count in jobs}
    walls = {count: wall for count, (wall, _) in runs.items()}
    warm_s, warm_cpu_s = measured(root, WARM, trials=trials)
    found: dict[str, object] = {
        "trials_per_minute": {str(count): round(60 * trials / wall, 1) for count, wall in walls.items()},
        "warm_trial_s": round(warm_s, 3),
        "warm_trial_cpu_s": round(warm_cpu_s, 3),
        "supervision_s": round(measured(root, COPY, trials=trials)[0], 3),
    }
    if 1 in runs:
        found["overhead_s"] = round(walls[1] / trials - warm_s, 3)
        found["overhead_cpu_s"] = round(runs[1][1] - warm_cpu_s, 3)
        found["times_one_job"] = {str(count): round(walls[1] / wall, 2) for count, wall in walls.items() if count > 1}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=8)
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=1, help="measurements in turn; all of them are printed")
    parser.add_argument("--before", type=Path, help="another checkout to measure beside this one")
    arguments = parser.parse_args()
    roots = {"before": arguments.before.resolve()} if arguments.before else {}
    roots["now"] = HERE
    rounds = [
        {name: suite(root, trials=arguments.trials, jobs=arguments.jobs) for name, root in roots.items()}
        for _ in range(arguments.rounds)
    ]
    print(
        json.dumps(
            {
                "cores": len(os.sched_getaffinity(0)), "load": os.getloadavg()[0], "time": time.strftime("%H:%M"),
                "trial": ASKED, "trials": arguments.trials, "rounds": rounds,
                "median_overhead_s": {
                    name: median(each[name]["overhead_s"] for each in rounds) for name in roots if 1 in arguments.jobs
                },
            },
            indent=2,
        )
    )  # fmt: skip


if __name__ == "__main__":
    main()
