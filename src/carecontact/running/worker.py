"""One trial in its own process: ``python -m carecontact.running.worker [PARENT]`` with a ``TrialRequest`` on standard
input. It ends with the process PARENT, which started it.

The worker reports what its supervisor has to know on a pipe (``Reports``). Exit status 0 means that the recording was
written, whatever happened to the trial, or that a report says why there is none. A crash of the interpreter itself
writes nothing; then the supervisor writes a recording.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING, TypedDict, Unpack

from carecontact.serving.process_tree import wait_for_children
from carecontact.system import adopt_orphans, die_with_parent

if TYPE_CHECKING:
    from carecontact.running.engine import TrialRequest
    from carecontact.running.trial import Look

THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "BLIS")
REMOVED_S = 3600.0
"""Longest wait [s] for the removal of what a policy filled the disk with, before the recording cannot be stored."""


def worker_environment() -> dict[str, str]:
    """Return the variables of this process with those that a trial needs. A sum split over threads depends on how many
    there are, and the supervisor already uses every core. MUJOCO_GL keeps MuJoCo from importing glfw, which it needs
    for windows alone: 0.1 s and a process of its own; ``sim.rendering`` chooses the backend for pictures itself. A
    user's own MUJOCO_GL stays."""
    threads = {f"{library}_NUM_THREADS": "1" for library in THREADS}
    return {"MUJOCO_GL": "disable", **os.environ, **threads, "PYTHONHASHSEED": "0"}


class Reports(TypedDict, total=False):
    """What a worker reports to its supervisor, each by itself."""

    policy_runs: bool
    """Whether the process of a local policy is about to start, or is gone."""
    answer: str
    """Digest of one answer, in base 16."""
    warnings: list[str]
    """Warnings about the first answer."""
    waiting: str
    """A line about a policy that is silent."""
    unreached: str
    """Why no trial can begin here: the policy's server cannot be reached, or a package is missing."""
    unstored: str
    """The place without space for what the trial stores; empty for that of the recording."""


def main(parent: int) -> int:
    # Before the imports below, which take half a second.
    die_with_parent(parent)
    os.environ.update(worker_environment())
    adopt_orphans()
    from carecontact.errors import StorageError
    from carecontact.recording.file import is_full
    from carecontact.running.engine import TrialRequest

    request = TrialRequest.model_validate_json(sys.stdin.buffer.read())
    one_at_a_time = Lock()

    def report(**said: Unpack[Reports]) -> None:
        if request.status_fd is not None:
            with one_at_a_time, open(request.status_fd, "w", closefd=False) as pipe:
                pipe.write(f"{json.dumps(said)}\n")

    try:
        _run(request, report)
    except Exception as error:
        if not is_full(error):
            raise
        # Of the recording itself, the supervisor knows a better name of the place.
        elsewhere = isinstance(error, StorageError) and str(request.out.parent) not in str(error)
        report(unstored=str(error) if elsewhere else "")
    return 0


def _run(request: TrialRequest, report: Callable[..., None]) -> None:
    from carecontact.errors import CarecontactError, DependencyError, UnreachableError
    from carecontact.recording import write_recording
    from carecontact.recording.file import is_full
    from carecontact.recording.schema import EXHAUSTED, Origin
    from carecontact.running.lost import digest_of, harness_error_recording, tail
    from carecontact.system import is_exhausted

    looked = False

    def look(look: Look) -> None:
        from carecontact.running.check_answers import look_at

        nonlocal looked
        report(answer=digest_of(look.actions).hex())
        if not looked:
            found = look_at(look.actions, look.observation)
            report(warnings=[f"{finding.topic}: {finding.text}" for finding in found])
            looked = True

    try:
        from carecontact.running.trial import run_trial

        recording = run_trial(
            request.spec,
            policy=request.policy,
            weights=request.weights,
            pace_s=request.pace_s,
            on_look=look,
            on_policy=lambda runs: report(policy_runs=runs),
            on_wait=lambda line: report(waiting=line),
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
        report(unreached=str(error))
    except Exception as error:
        if is_full(error):
            raise
        trace = traceback.format_exc()
        sys.stderr.write(trace)
        reason = str(error) if isinstance(error, CarecontactError) else f"{type(error).__name__}: {error}"
        kind = EXHAUSTED if is_exhausted(error) else type(error).__name__
        failed = harness_error_recording(request.spec, kind=kind, message=f"{reason}\n\n{tail(trace)}")
        write_recording(failed, request.out)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if sys.argv[1:] else os.getppid()))
