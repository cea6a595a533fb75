"""The process between the harness and the policy's: it closes off what the policy does not need, starts the policy's
process by a fork, and reports how that ended.

With it ends everything that the policy started: in namespaces, the kernel does that; elsewhere, this process adopts and
kills what is left (``isolation.process_tree``). It ends when the policy does, and when the harness closes its end of a
socket, which the kernel does for a harness that is killed.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.hosting.isolation.fence import isolate, prepare
from carecontact.hosting.isolation.namespaces import enter, mount_processes, start_init
from carecontact.hosting.isolation.private_folder import remove_and_exit
from carecontact.hosting.isolation.process_tree import PATIENCE_S, kill_children, reap
from carecontact.hosting.readable import readable
from carecontact.hosting.stack import ASK
from carecontact.own_process import adopt_orphans, die_with_parent

if TYPE_CHECKING:
    from carecontact.hosting.child import Options

ENDING_S = PATIENCE_S + 1.0
"""Longest wait [s] of the harness for the end of this process."""
NO_PROCESS = os.EX_OSERR
"""Exit status if the policy's process cannot be started."""
UNMOVED_BY = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that whoever stops a command may send to all its processes. This one ends with the harness anyway, and before
that it has to kill what the policy started."""


def start(options: Options) -> None:
    """Divide this process, which has one thread, in two: one waits and never returns from here, and the other, the
    policy's, is isolated and returns."""
    own = os.getpid()
    # Whoever started the harness may have changed these, and neither of the two works with blocked signals.
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    allowed = prepare(options) if options["isolated"] else None
    init, held = None, None
    try:
        if options["namespaces"]:
            assert allowed is not None
            os.environ["TMPDIR"] = enter(allowed.places)
            init, held = start_init()
        else:
            adopt_orphans()
        policy = os.fork()
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        os._exit(NO_PROCESS)
    if policy == 0:
        for descriptor in (options["lifeline_fd"], options["lock_fd"], held):
            if descriptor is not None:
                os.close(descriptor)
        os.setsid()
        if options["namespaces"]:
            mount_processes()
        else:
            die_with_parent(own)
        isolate(options, allowed)
        return
    for descriptor in (options["report_fd"], options["stack_fd"]):
        os.close(descriptor)
    _watch(policy, init, options["lifeline_fd"], folder=None if options["namespaces"] else Path(os.environ["TMPDIR"]))


def _watch(policy: int, init: int | None, lifeline: int, *, folder: Path | None) -> None:
    statuses: dict[int, int | None] = dict.fromkeys(filter(None, (policy, init)))
    try:
        _wait(policy, lifeline, statuses)
        _end(policy, init, statuses)
        status = statuses[policy]
        # The harness reads to the end of what the policy prints.
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(nowhere, descriptor)
        with suppress(OSError):  # The harness may be gone.
            os.write(lifeline, str(-signal.SIGKILL if status is None else status).encode())
        os.close(lifeline)
    except BaseException:
        _pass_on(signal.SIGKILL, policy, statuses)
        raise
    if folder is None:
        os._exit(0)
    # Here and not in the harness, which may end at any moment, and has other things to do if this takes long.
    remove_and_exit(folder)


def _wait(policy: int, lifeline: int, statuses: dict[int, int | None]) -> None:
    """Wait for the end of the policy's process or of the lifeline."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(ASK, lambda *_: _pass_on(ASK, policy, statuses))
    for number in UNMOVED_BY:
        signal.signal(number, signal.SIG_IGN)
    more = True  # The policy's process may have ended before the signal had its handler.
    while statuses[policy] is None:
        ready = readable([lifeline, woken], 0.0 if more else None)
        if lifeline in ready:
            return
        if ready:
            os.read(woken, 4096)
        with suppress(ChildProcessError):
            more = reap(statuses)


def _pass_on(number: int, policy: int, statuses: dict[int, int | None]) -> None:
    # The id of a process that has ended may be that of another one by now.
    if statuses[policy] is None:
        with suppress(ProcessLookupError):
            os.kill(policy, number)


def _end(policy: int, init: int | None, statuses: dict[int, int | None]) -> None:
    """Kill everything that the policy started, itself included."""
    if init is None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(policy, signal.SIGKILL)
        kill_children(statuses)
        return
    if statuses[init] is None:
        os.kill(init, signal.SIGKILL)
    while None in statuses.values():
        pid, status = os.waitpid(-1, 0)
        statuses[pid] = os.waitstatus_to_exitcode(status)
