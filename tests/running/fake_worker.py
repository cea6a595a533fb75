"""Stands in for the trial worker: does what FAKE_PLAN says for its trial, and notes in FAKE_LOG that it ran.

A list in the plan is what the attempts at one trial do, one after another. ``lost:abc`` first tells three answers.
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
    spec, out = request.spec, request.out
    trial_id = spec.trial_id
    with Path(os.environ["FAKE_LOG"]).with_name("commands.txt").open("a") as commands:
        variables = {name: value for name, value in os.environ.items() if name not in ("FAKE_PLAN", "FAKE_LOG")}
        commands.write(f"{out} {sys.orig_argv} {variables}\n")
    requests = Path(os.environ["FAKE_LOG"]).with_name("requests.jsonl")
    with requests.open("a") as stream:
        stream.write(f"{request.model_dump_json()}\n")
    note(f"{trial_id} {os.getpid()}")
    does = json.loads(os.environ["FAKE_PLAN"]).get(trial_id, "good")
    if isinstance(does, list):
        does = does[Path(os.environ["FAKE_LOG"]).read_text().count(trial_id) - 1]
    does, _, answers = does.partition(":")
    if answers:
        from carecontact.running.engine import ANSWERED, DIGEST_BYTES

        assert request.told_fd is not None
        for letter in answers:
            os.write(request.told_fd, ANSWERED + letter.encode() * DIGEST_BYTES)
    if does in ("lost", "lost_once", "lost_after", "stopped"):
        from carecontact.running.engine import POLICY_GONE, POLICY_RUNS

        assert request.told_fd is not None
        os.write(request.told_fd, POLICY_RUNS + (POLICY_GONE if does == "lost_after" else b""))
        if does != "lost_once" or Path(os.environ["FAKE_LOG"]).read_text().count(trial_id) == 1:
            os.kill(os.getpid(), signal.SIGSTOP if does == "stopped" else signal.SIGKILL)
        write(spec, out, "good")
    elif does == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif does == "exit":
        sys.stderr.write("evidence on stderr\n")
        sys.stderr.flush()
        os._exit(7)
    elif does == "garbage":
        out.write_bytes(b"not a recording")
    elif does == "full":
        from carecontact.running.worker import UNSTORED

        os._exit(UNSTORED)
    elif does == "hang":
        note(f"child {subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)']).pid}")
        time.sleep(600)
    elif does == "starve":
        from carecontact.running.engine import POLICY_RUNS

        assert request.told_fd is not None
        os.write(request.told_fd, POLICY_RUNS)
        time.sleep(600)
    elif does in ("lack", "lack_with_policy"):
        from carecontact.recording import write_recording
        from carecontact.recording.schema import EXHAUSTED
        from carecontact.running.engine import POLICY_RUNS
        from carecontact.running.lost import harness_error_recording

        assert request.told_fd is not None
        if does == "lack_with_policy":
            os.write(request.told_fd, POLICY_RUNS)
        write_recording(harness_error_recording(spec, kind=EXHAUSTED, message="no thread is left\n\nTrace"), out)
    elif does == "slow_lost":
        time.sleep(2)
        os.kill(os.getpid(), signal.SIGKILL)
    elif does == "beside":
        # Another command begins a run.
        (out.parents[3] / "later").mkdir()
        (out.parents[3] / "later" / "manifest.json").touch()
        write(spec, out, "good")
    elif does == "unreached" or (does == "unreached_server" and "://" in spec.policy):
        from carecontact.running.worker import UNREACHED

        out.with_name(UNREACHED).write_text("nothing listens there")
    elif does == "answers":
        from carecontact.running.worker import FIRST_ANSWER

        out.with_name(FIRST_ANSWER).write_text(json.dumps(["quaternion: as of " + trial_id, "done: \x1b[2J"]))
        write(spec, out, "good")
    elif does == "slow":
        time.sleep(3)
        write(spec, out, "good")
    elif does != "nothing":
        write(spec, out, "good" if does == "unreached_server" else does)
    return 0


def note(line: str) -> None:
    with Path(os.environ["FAKE_LOG"]).open("a") as log:
        log.write(f"{line}\n")


def write(spec: TrialSpec, out: Path, does: str) -> None:
    from carecontact.recording import write_recording
    from carecontact.recording.schema import Failure

    if does == "other":
        spec = spec.model_copy(update={"seed": spec.seed + 1})
    endings = {"policy": "process_failure", "policy_killed": "process_failure"}
    made = recording(spec, endings.get(does, "done"))
    if does == "policy_killed":
        killed = Failure(kind="killed", message="policy 'x' failed at act: its process was killed by SIGKILL")
        made = replace(made, header=made.header.model_copy(update={"failure": killed}))
    write_recording(made, out)
    if does == "late_crash":
        os.kill(os.getpid(), signal.SIGSEGV)


if __name__ == "__main__":
    sys.exit(main())
