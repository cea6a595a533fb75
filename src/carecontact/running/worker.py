"""One trial in its own process: ``python -m carecontact.running.worker [PARENT]`` with a ``TrialRequest`` on standard
input. It ends with the process PARENT, which started it.

The worker reports to its supervisor when a local policy runs and what it answered (``running.engine``). Exit status 0
means that the recording was written, whatever happened to the trial, or that UNREACHED says why the trial did not
begin; LACKING, that this machine lacks a package, which UNREACHED names; UNSTORED, that there was no space for the
recording. A crash of the interpreter itself writes nothing; then the supervisor writes a recording.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from carecontact.serving.process_tree import claim_children, wait_for_children
from carecontact.system import die_with_parent

if TYPE_CHECKING:
    from carecontact.running.trial import Look

THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "BLIS")
WAITING = "waiting.txt"
"""File beside the recording in which the worker says that it waits for its policy."""
FIRST_ANSWER = "first_answer.json"
"""File beside it with the warnings about the policy's first answer: a list of texts."""
UNREACHED = "unreached.txt"
"""File beside it in which the worker says why no trial can begin here, since it does not reach the policy's server or a
package is missing; then there is no recording."""
NO_SPACE = "no_space.txt"
"""File beside it in which the worker says which other place than that of the recording has no space."""
REMOVED_S = 3600.0
"""Longest wait [s] for the removal of what a policy filled the disk with, before the recording cannot be stored."""
UNSTORED = 74
"""Exit status: EX_IOERR of sysexits.h."""
LACKING = 69
"""Exit status: EX_UNAVAILABLE of sysexits.h. A status, because a policy of this machine could write the file."""


def worker_environment() -> dict[str, str]:
    """Return the variables of this process with those that a trial needs.

    A sum split over threads depends on how many there are, and the supervisor already uses every core. MUJOCO_GL keeps
    MuJoCo from importing glfw, which it needs for windows alone: 0.1 s and a process of its own; ``sim.rendering``
    chooses the backend for pictures itself. A user's own MUJOCO_GL stays.
    """
    return {"MUJOCO_GL": "disable", **os.environ, **{f"{library}_NUM_THREADS": "1" for library in THREADS}}


def main(parent: int) -> int:
    # Before the imports below, which take half a second.
    die_with_parent(parent)
    os.environ.update(worker_environment())
    claim_children()
    from carecontact.recording.file import is_full

    try:
        return _run()
    except Exception as error:
        if not is_full(error):
            raise
        return UNSTORED


def _run() -> int:
    """Return the exit status. Raises StorageError or OSError where there is no space for what it writes."""
    from carecontact.errors import CarecontactError, DependencyError, StorageError, UnreachableError
    from carecontact.recording import write_recording
    from carecontact.recording.file import is_full
    from carecontact.recording.schema import EXHAUSTED, Origin
    from carecontact.running.engine import ANSWERED, POLICY_GONE, POLICY_RUNS, TrialRequest
    from carecontact.running.lost import digest_of, harness_error_recording, tail
    from carecontact.system import is_exhausted

    request = TrialRequest.model_validate_json(sys.stdin.buffer.read())

    def report(status: bytes) -> None:
        if request.status_fd is not None:
            os.write(request.status_fd, status)

    def note(name: str, text: str) -> None:
        # A policy may fill the disk; what it fills is free again when the recording is written.
        with suppress(OSError):
            request.out.with_name(name).write_text(text)

    def look(look: Look) -> None:
        from carecontact.running.check_answers import look_at

        report(ANSWERED + digest_of(look.actions))
        if not request.out.with_name(FIRST_ANSWER).exists():
            found = look_at(look.actions, look.observation)
            note(FIRST_ANSWER, json.dumps([f"{finding.topic}: {finding.text}" for finding in found]))

    try:
        from carecontact.running.trial import run_trial

        recording = run_trial(
            request.spec,
            policy=request.policy,
            weights=request.weights,
            pace_s=request.pace_s,
            on_look=look,
            on_policy=lambda runs: report(POLICY_RUNS if runs else POLICY_GONE),
            on_wait=lambda line: note(WAITING, line),
        )
        origin: Origin = "served" if request.policy.ref.kind == "remote" else "isolated"
        origin = "training" if request.spec.trains else origin
        recording = replace(recording, header=recording.header.model_copy(update={"origin": origin}))
        try:
            write_recording(recording, request.out)
        except Exception as error:
            # What a policy filled the disk with may still be being removed.
            if not is_full(error) or not wait_for_children(REMOVED_S):
                raise
            write_recording(recording, request.out)
    except (UnreachableError, DependencyError) as error:
        request.out.with_name(UNREACHED).write_text(str(error))
        return LACKING if isinstance(error, DependencyError) else 0
    except Exception as error:
        if is_full(error):
            # Of the recording itself, the supervisor knows a better name of the place.
            if isinstance(error, StorageError) and str(request.out.parent) not in str(error):
                note(NO_SPACE, str(error))
            raise
        trace = traceback.format_exc()
        sys.stderr.write(trace)
        reason = str(error) if isinstance(error, CarecontactError) else f"{type(error).__name__}: {error}"
        kind = EXHAUSTED if is_exhausted(error) else type(error).__name__
        failed = harness_error_recording(request.spec, kind=kind, message=f"{reason}\n\n{tail(trace)}")
        write_recording(failed, request.out)
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if sys.argv[1:] else os.getppid()))
