"""One trial in its own process: ``python -m carecontact.trials.worker`` with ``{"spec": ..., "out": PATH}`` on stdin.

Not on the command line, where a policy could read which task and seed it is given. With ``"phase_fd": N`` it writes
POLICY_RUNS to that file when the process of a local policy is about to start and POLICY_GONE when it is gone. Exit
status 0 means that PATH was written, whatever happened to the trial. A crash of the interpreter itself writes nothing;
then the supervisor writes a recording.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path

SINGLE_THREAD = {
    name: "1"
    for name in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "BLIS_NUM_THREADS",
    )
}
"""A sum split over threads depends on how many there are; and the supervisor already uses every core."""


POLICY_RUNS, POLICY_GONE = b"+", b"-"


def main() -> int:
    os.environ.update(SINGLE_THREAD)
    from carecontact.contract.trial import TrialSpec
    from carecontact.errors import CarecontactError
    from carecontact.recording import write_recording
    from carecontact.trials.failed import harness_error_recording, tail

    asked = json.loads(sys.stdin.buffer.read())
    spec, out = TrialSpec.model_validate(asked["spec"]), Path(asked["out"])
    phase_fd: int | None = asked.get("phase_fd")

    def tell(running: bool) -> None:
        if phase_fd is not None:
            os.write(phase_fd, POLICY_RUNS if running else POLICY_GONE)

    try:
        from carecontact.trials.trial import run_trial

        write_recording(run_trial(spec, on_policy=tell), out)
    except Exception as error:
        trace = traceback.format_exc()
        sys.stderr.write(trace)
        told = str(error) if isinstance(error, CarecontactError) else f"{type(error).__name__}: {error}"
        failed = harness_error_recording(spec, kind=type(error).__name__, message=f"{told}\n\n{tail(trace)}")
        write_recording(failed, out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
