"""Stands in for the trial worker: does what FAKE_PLAN says for its trial, and notes in FAKE_LOG that it ran."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carecontact.contract.trial import TrialSpec
    from carecontact.recording.schema import Recording


def recording(spec: TrialSpec, ended: str) -> Recording:
    from carecontact.recording.schema import SEGMENTS, Failure, Header, Recording, empty_arrays

    header = Header.model_validate(
        {
            "spec": spec,
            "ended": ended,
            "failure": Failure(kind="died", message="gone\nmore") if ended == "process_failure" else None,
            "card": None,
            "embodiment": "test",
            "comfort_arm_deg": 50.0,
            "segments": list(SEGMENTS),
            "regions": ["forearm", "upper_arm", "abdomen"],
            "human_joints": [],
            "pose_base_in_world": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            "versions": {},
            "sha256": {},
            "solver_warnings": [],
        }
    )
    return Recording(header=header, arrays=empty_arrays(0))


def main(spec_file: str, out: str) -> int:
    trial_id = Path(spec_file).stem
    note(f"{trial_id} {os.getpid()}")
    does = json.loads(os.environ["FAKE_PLAN"]).get(trial_id, "good")
    if does == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif does == "exit":
        sys.stderr.write("evidence on stderr\n")
        sys.stderr.flush()
        os._exit(7)
    elif does == "garbage":
        Path(out).write_bytes(b"not a recording")
    elif does == "hang":
        note(f"child {subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)']).pid}")
        time.sleep(600)
    elif does != "nothing":
        write(spec_file, out, does)
    return 0


def note(line: str) -> None:
    with Path(os.environ["FAKE_LOG"]).open("a") as log:
        log.write(f"{line}\n")


def write(spec_file: str, out: str, does: str) -> None:
    from carecontact.contract.trial import TrialSpec
    from carecontact.recording import write_recording

    spec = TrialSpec.model_validate_json(Path(spec_file).read_bytes())
    if does == "other":
        spec = spec.model_copy(update={"seed": spec.seed + 1})
    endings = {"good": "done", "policy": "process_failure", "late_crash": "done", "other": "done"}
    write_recording(recording(spec, endings[does]), out)
    if does == "late_crash":
        os.kill(os.getpid(), signal.SIGSEGV)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
