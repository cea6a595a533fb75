"""How fast this machine runs trials: wall-clock seconds for each simulated second, one trial a core."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from carecontact.protocols import load_protocol
from carecontact.recording import read_recording
from carecontact.trials.plan import parse_seeds, plan_trials
from carecontact.trials.supervisor import available_cores, run_trials


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--policy", default="zero-action")
    options.add_argument("--task", default="T1")
    options.add_argument("--jobs", type=int, default=available_cores())
    chosen = options.parse_args()
    protocol = load_protocol()
    seeds = parse_seeds(f"0-{chosen.jobs - 1}", protocol=protocol)
    specs = plan_trials(protocol=protocol, policy=chosen.policy, tasks=[chosen.task], seeds=seeds)
    with tempfile.TemporaryDirectory() as folder:
        summary = run_trials(specs, out=Path(folder), jobs=chosen.jobs)
        recordings = [read_recording(Path(folder) / f"{spec.trial_id}.h5") for spec in specs]
    simulated = sum(float(r["scorer/time_s"][-1]) for r in recordings if len(r["scorer/time_s"]))
    print(f"{len(specs)} trial(s) of {chosen.policy} on {chosen.task}, {chosen.jobs} at once: {summary.ended}")
    if not simulated:
        print("nothing was simulated")
        return 1
    print(
        f"{summary.wall_s:.1f} s for {simulated:.1f} s of simulated time: {simulated / summary.wall_s:.2f} x real time"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
