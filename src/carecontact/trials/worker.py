"""One trial in its own process: ``python -m carecontact.trials.worker`` with a ``TrialRequest`` on standard input.

The worker writes POLICY_RUNS to the request's ``phase_fd`` when the process of a local policy is about to start, and
POLICY_GONE when it is gone. Exit status 0 means that the recording was written, whatever happened to the trial, or that
UNREACHED says why the trial did not begin; UNSTORED, that there was no space for the recording. A crash of the
interpreter itself writes nothing; then the supervisor writes a recording.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from typing import TYPE_CHECKING

from carecontact.hosting.isolation.kernel import die_with_parent, hide_memory

if TYPE_CHECKING:
    from carecontact.trials.trial import Look

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

WAITING = "waiting.txt"
"""File beside the recording in which the worker says that it waits for its policy."""
FIRST_ANSWER = "first_answer.json"
"""File beside it with the warnings about the policy's first answer: a list of texts."""
UNREACHED = "unreached.txt"
"""File beside it in which the worker says why it could not reach its policy's server; then there is no recording."""
POLICY_RUNS, POLICY_GONE = b"+", b"-"
UNSTORED = 74
"""Exit status: EX_IOERR of sysexits.h."""


def main() -> int:
    # Before the imports below, which take half a second; the request then tells whether it was too late even here.
    die_with_parent(os.getppid())
    os.environ.update(SINGLE_THREAD)
    hide_memory()
    from carecontact.recording.storage import is_full

    try:
        _run()
    except Exception as error:
        if not is_full(error):
            raise
        return UNSTORED
    return 0


def _run() -> None:
    """Raises StorageError or OSError where there is no space for what it writes."""
    from carecontact.errors import CarecontactError, UnreachableError
    from carecontact.recording import write_recording
    from carecontact.recording.storage import is_full
    from carecontact.trials.failed import harness_error_recording, tail
    from carecontact.trials.lost import ANSWERS, digest_of
    from carecontact.trials.request import TrialRequest

    request = TrialRequest.model_validate_json(sys.stdin.buffer.read())
    if request.supervisor is not None:
        die_with_parent(request.supervisor)

    def tell(running: bool) -> None:
        if request.phase_fd is not None:
            os.write(request.phase_fd, POLICY_RUNS if running else POLICY_GONE)

    def wait(line: str) -> None:
        request.out.with_name(WAITING).write_text(line)

    def look(look: Look) -> None:
        from carecontact.trials.first_answer import look_at

        with request.out.with_name(ANSWERS).open("ab") as answers:
            answers.write(digest_of(look.actions))
        note = request.out.with_name(FIRST_ANSWER)
        if not note.exists():
            found = look_at(look.actions, look.observation)
            note.write_text(json.dumps([f"{finding.topic}: {finding.text}" for finding in found]))

    try:
        from carecontact.trials.trial import run_trial

        recording = run_trial(
            request.spec, policy=request.policy, weights=request.weights, pace_s=request.pace_s,
            on_look=look, on_policy=tell, on_wait=wait,
        )  # fmt: skip
        write_recording(recording, request.out)
    except UnreachableError as error:
        request.out.with_name(UNREACHED).write_text(str(error))
    except Exception as error:
        if is_full(error):
            raise
        trace = traceback.format_exc()
        sys.stderr.write(trace)
        reason = str(error) if isinstance(error, CarecontactError) else f"{type(error).__name__}: {error}"
        message = f"{reason}\n\n{tail(trace)}"
        write_recording(harness_error_recording(request.spec, kind=type(error).__name__, message=message), request.out)


if __name__ == "__main__":
    sys.exit(main())
