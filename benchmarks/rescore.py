"""Time to score a run again, as JSON on standard output: 140 synthetic trials, the number that the paper runs a method.

    python benchmarks/rescore.py [--trials 140] [--seconds 30] [--jobs N]

Every trial lasts ``--seconds`` (30 is the protocol's time limit, so the longest there is) with noise in every stream,
so that nothing compresses better than a simulation's. Seconds include starting the processes; on a shared machine the
CPU seconds over the processes say what an idle one would take, and 10 of them for 140 trials on two cores are the line
to keep. The stages are CPU milliseconds of one trial in this process, best of three, mean of the seven tasks.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the synthetic recordings of the tests

from tests.scoring.synthetic import SEGMENTS, back_and_forth, make_recording, seconds, target_segment

from carecontact.cli.publish import processes
from carecontact.recording import Recording, read_recording, write_recording
from carecontact.recording.file import canonical_digest, header_json
from carecontact.runs import score_run, write_scores
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.gate_sweep import sweep_gates
from carecontact.scoring.metrics.success import judge, measure
from carecontact.scoring.validity import check_streams
from carecontact.scoring.verdict import reach_verdict

TASKS = ("T1", "T2", "T3", "T4", "T5", "T6", "T7")
SUMS = ("of which the hash", "whole score without reading")
NOISE = 1e-5
NOISY = ("pose_tcp_in_world", "region_pose_in_world", "human_joint_position", "wrist_in_world", "tcp_rotation_speed")


def long_trial(task: str, duration_s: float, seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    steps = len(seconds(duration_s))
    force = np.abs(5 + rng.normal(scale=0.5, size=steps)) * (seconds(duration_s) > 0.1 * duration_s)
    region = make_recording(task, duration=0.1).header.spec.protocol.task(task).region
    recording = make_recording(
        task,
        duration=duration_s,
        normal={target_segment(task): force},
        tcp_in_region=back_and_forth(duration_s, region, amplitude=0.06, period=2.0),
        wrist_shift=np.full(steps, 0.03),
        speed=rng.uniform(0, 0.1, steps),
        seed=seed,
    )
    for name in NOISY:
        clean = recording[f"scorer/{name}"]
        noisy = clean + rng.normal(scale=NOISE, size=clean.shape).astype(clean.dtype)
        recording.arrays[f"scorer/{name}"] = np.abs(noisy) if name.endswith("speed") else noisy
    pushed = recording["scorer/centroid_in_world"][:, SEGMENTS.index(target_segment(task))]
    pushed += rng.normal(scale=NOISE, size=pushed.shape).astype(pushed.dtype)
    return recording


def milliseconds(work: Callable[[], Any]) -> tuple[float, Any]:
    best, result = np.inf, None
    for _ in range(3):
        start = time.process_time()
        result = work()
        best = min(best, time.process_time() - start)
    return best * 1e3, result


def cpu_seconds() -> float:
    """Of this process and of those it started and waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def stages(path: Path) -> dict[str, float]:
    spent: dict[str, float] = {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        spent[name], result = milliseconds(work)
        return result

    recording = timed("read and verify", lambda: read_recording(path))
    timed("of which the hash", lambda: canonical_digest(header_json(recording.header), recording.arrays))
    timed("check of the streams", lambda: check_streams(recording))
    contact = timed("contact", lambda: find_contact(recording))
    measures = timed("stroke and wrist", lambda: measure(contact))
    verdict = timed("verdict", lambda: reach_verdict(contact, judge(contact, measures)))
    timed("gate sweep", lambda: sweep_gates(contact, measures, verdict))
    for id_ in METRICS:
        timed(f"metric {id_}", lambda id_=id_: METRICS[id_].compute(contact))
    timed("whole score without reading", lambda: score_recording(recording))
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=140)
    parser.add_argument("--seconds", type=float, default=30.0, help="of every trial")
    parser.add_argument("--jobs", type=int, default=None, help="processes; default: as many as pay")
    options = parser.parse_args()
    jobs = options.jobs or processes(options.trials)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(options.trials):
            recording = long_trial(TASKS[number % len(TASKS)], options.seconds, number // len(TASKS))
            path = folder / f"{recording.header.spec.trial_id}.h5"
            write_recording(recording, path)
        size = sum(p.stat().st_size for p in folder.iterdir())
        start, cpu = time.perf_counter(), cpu_seconds()
        run = score_run(folder, jobs=jobs)
        scored, cpu = time.perf_counter(), cpu_seconds() - cpu
        write_scores(folder, run)
        written = time.perf_counter()
        if len(run.scores) != options.trials:
            raise SystemExit(f"{len(run.scores)} of {options.trials} trials scored: {run.skipped}")
        parts = [stages(folder / f"{task}-s000.h5") for task in TASKS[: options.trials]]
    mean = {stage: round(float(np.mean([p[stage] for p in parts])), 1) for stage in parts[0]}
    once = {stage: ms for stage, ms in mean.items() if stage not in SUMS}
    report = {
        "trials": options.trials,
        "seconds_each": options.seconds,
        "megabytes": round(size / 1e6, 1),
        "jobs": jobs,
        "score_wall_s": round(scored - start, 2),
        "score_cpu_s": round(cpu, 2),
        "score_cpu_s_over_jobs": round(cpu / jobs, 2),
        "write_results_wall_s": round(written - scored, 2),
        "cpu_ms_of_a_trial": mean,
        "limited_by": max(once, key=lambda stage: once[stage]),
    }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
