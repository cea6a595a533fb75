"""One trial in a process of its own: ``python -m carecontact.trials.worker SPEC.json OUT.h5``.

Exit status 0 means that OUT.h5 was written, whatever happened to the trial. A crash of the interpreter itself writes
nothing; the supervisor then writes the recording.
"""

from __future__ import annotations

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


def main(arguments: list[str]) -> int:
    if len(arguments) != 2:
        sys.stderr.write("usage: python -m carecontact.trials.worker SPEC.json OUT.h5\n")
        return 2
    os.environ.update(SINGLE_THREAD)
    from carecontact.contract.trial import TrialSpec
    from carecontact.errors import CarecontactError
    from carecontact.recording import write_recording
    from carecontact.trials.failed import harness_error_recording, tail

    spec = TrialSpec.model_validate_json(Path(arguments[0]).read_bytes())
    try:
        from carecontact.trials.trial import run_trial

        write_recording(run_trial(spec), Path(arguments[1]))
    except Exception as error:
        trace = traceback.format_exc()
        sys.stderr.write(trace)
        told = str(error) if isinstance(error, CarecontactError) else f"{type(error).__name__}: {error}"
        failed = harness_error_recording(spec, kind=type(error).__name__, message=f"{told}\n\n{tail(trace)}")
        write_recording(failed, Path(arguments[1]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
