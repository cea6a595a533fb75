"""Stands in for the trial worker: does what FAKE_PLAN says for its trial, and notes in FAKE_LOG that it ran.

A list in the plan is what the attempts at one trial do, one after another. ``lost:abc`` first reports three answers;
``outlasts`` ends after two attempts at T1-s001.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carecontact.protocol.protocol import TrialSpec
    from carecontact.recording.schema import Recording


BROKE = (
    "policy 'x' failed at act: Traceback (most recent call last):\n  File \"p.py\", line 3, in act\n    boom()\n"
    "NoGrip: nothing there\n (exit code 0)\nit printed last:\nValueError: only printed"
)


def recording(spec: TrialSpec, ended: str) -> Recording:
    from carecontact.recording.schema import SEGMENTS, Failure, Header, Recording, empty_arrays

    header = Header.model_validate(
        {
            "spec": spec,
            "ended": ended,
            "failure": Failure(kind="exception", message=BROKE) if ended == "process_failure" else None,
            "card": None,
            "embodiment": "test",
            "comfort_arm_deg": 50.0,
            "segments": list(SEGMENTS),
            "regions": ["forearm", "upper_arm", "abdomen"],
            "human_joints": [],
            "pose_base_in_world": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            "identity": {},
            "versions": {},
            "sha256": {},
            "solver_warnings": [],
        }
    )
    return Recording(header=header, arrays=one_quiet_period(spec) if ended != "process_failure" else empty_arrays(0))


def one_quiet_period(spec: TrialSpec) -> dict[str, Any]:
    """Nothing is touched and nothing moves."""
    import numpy as np

    from carecontact.recording.schema import ARRAYS, empty_arrays

    physics = spec.protocol.physics
    steps = round(physics.target_period_s / physics.dt_s)
    arrays: dict[str, Any] = empty_arrays(0)
    for path, (_, meaning) in ARRAYS.items():
        if meaning.startswith("(T"):
            arrays[path] = np.zeros((steps, *arrays[path].shape[1:]), arrays[path].dtype)
    arrays["scorer/time_s"] = np.arange(steps) * physics.dt_s
    arrays["scorer/pose_tcp_in_world"][:, 3] = 1.0
    arrays["scorer/region_pose_in_world"][:, :, 3] = 1.0
    arrays["scorer/region_size_m"] = np.full((3, 3), 0.1)
    arrays["scorer/period_time_s"] = np.array([physics.target_period_s])
    for path in ("scorer/indentation_m", "scorer/target_in_base"):
        arrays[path] = np.zeros((1, *arrays[path].shape[1:]), arrays[path].dtype)
    return arrays


def main() -> int:
    from carecontact.running.engine import TrialRequest

    request = TrialRequest.model_validate_json(sys.stdin.buffer.read())
    spec, out, log = request.spec, request.out, Path(os.environ["FAKE_LOG"])

    def report(**said: object) -> None:
        assert request.status_fd is not None
        os.write(request.status_fd, f"{json.dumps(said)}\n".encode())

    variables = {name: value for name, value in os.environ.items() if name not in ("FAKE_PLAN", "FAKE_LOG")}
    append(log.with_name("commands.txt"), f"{out} {sys.orig_argv} {variables}")
    append(log.with_name("requests.jsonl"), request.model_dump_json())
    append(log, f"{spec.trial_id} {os.getpid()}")
    attempt = log.read_text().count(spec.trial_id)
    does = json.loads(os.environ["FAKE_PLAN"]).get(spec.trial_id, "good")
    does, _, answers = (does[attempt - 1] if isinstance(does, list) else does).partition(":")
    for letter in answers:
        report(answer=(letter.encode() * 32).hex())
    if does in ("lost", "lost_once", "lost_after", "starve", "lack_with_policy"):
        report(policy_runs=True)
    if does == "lost_after":
        report(policy_runs=False)
    while does == "outlasts" and log.read_text().count("T1-s001") < 2:
        time.sleep(0.05)
    if does in ("slow", "slow_lost", "outlasts"):
        time.sleep(3 if does == "slow" else 2)
    if does in ("lost", "lost_after", "kill", "slow_lost") or (does == "lost_once" and attempt == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    elif does == "exit":
        sys.stderr.write("evidence on stderr\n")
        sys.stderr.flush()
        os._exit(7)
    elif does == "garbage":
        out.write_bytes(b"not a recording")
    elif does == "full":
        report(unstored="")
    elif does in ("hang", "starve"):
        if does == "hang":
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
            append(log, f"child {child.pid}")
        time.sleep(600)
    elif does in ("lack", "lack_with_policy"):
        from carecontact.recording import write_recording
        from carecontact.recording.schema import EXHAUSTED
        from carecontact.running.lost import harness_error_recording

        write_recording(harness_error_recording(spec, kind=EXHAUSTED, message="no thread is left\n\nTrace"), out)
    elif does == "unreached" or (does == "unreached_server" and "://" in spec.policy):
        report(unreached="nothing listens there")
    elif does != "nothing":
        if does == "beside":  # Another command begins a run.
            (out.parents[3] / "later").mkdir()
            (out.parents[3] / "later" / "manifest.json").touch()
        elif does == "answers":
            report(warnings=["quaternion: as of " + spec.trial_id, "done: \x1b[2J"])
        write(spec, out, does)
    return 0


def append(file: Path, line: str) -> None:
    with file.open("a") as stream:
        stream.write(f"{line}\n")


def write(spec: TrialSpec, out: Path, does: str) -> None:
    from carecontact.recording import write_recording
    from carecontact.recording.schema import Failure

    if does == "other":
        spec = spec.model_copy(update={"seed": spec.seed + 1})
    made = recording(spec, "process_failure" if does in ("policy", "policy_killed") else "done")
    if does == "policy_killed":
        killed = Failure(kind="killed", message="policy 'x' failed at act: its process was killed by SIGKILL")
        made = replace(made, header=made.header.model_copy(update={"failure": killed}))
    write_recording(made, out)
    if does == "late_crash":
        os.kill(os.getpid(), signal.SIGSEGV)


def serve(place: Path) -> None:
    """Fork a fake worker for each request. ``place`` holds its working folder and its variables as JSON."""
    from importlib import import_module
    from types import SimpleNamespace

    from carecontact.running import fork_server

    def prepare() -> None:
        for name in ("recording", "running.engine", "running.lost", "running.worker"):
            import_module(f"carecontact.{name}")

    def work(server: int) -> int:
        folder, variables = json.loads(place.read_text())
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(variables)
        return main()

    fork_server.prepare, fork_server.worker = prepare, SimpleNamespace(main=work)  # pyright: ignore[reportAttributeAccessIssue]
    fork_server.main()


if __name__ == "__main__":
    sys.exit(serve(Path(sys.argv[2])) if len(sys.argv) > 2 else main())
