"""The keeper of a policy: the process between the harness and the policy's process, which it starts by a fork.

Every process that the policy starts stays below the keeper, because the keeper adopts those whose own parent ends
(Linux). When the policy ends, or the harness closes its end of the lifeline or is killed, the keeper kills them all,
tells over the lifeline how the policy ended, and removes its temporary folder.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.hosting.descendants import PATIENCE_S, kill_children, reap
from carecontact.hosting.isolation.landlock import confine_signals
from carecontact.hosting.isolation.private_folder import become_remover
from carecontact.hosting.readable import readable
from carecontact.hosting.stack import ASK
from carecontact.own_process import adopt_orphans, die_with_parent, hide_memory

if TYPE_CHECKING:
    from carecontact.hosting.child import Options

KEEPER_S = PATIENCE_S + 1.0
"""Longest wait [s] of the harness for a keeper that shall end."""
NO_PROCESS = os.EX_OSERR
"""Exit status of a keeper that cannot start the policy's process."""
UNMOVED_BY = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that whoever stops a command may send to all its processes. The keeper ends with the command anyway, and
before that it has to kill what the policy started."""


def keep(options: Options) -> None:
    """Divide this process, which has one thread, into the keeper, which never returns from here, and the policy's
    process, which does.
    """
    keeper, harness = os.getpid(), os.getppid()
    # Whoever started the harness may have changed these, and neither keeper nor policy works with blocked signals.
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    adopt_orphans()
    alone = options["isolated"] and confine_signals() and _refused(harness)
    try:
        policy = os.fork()
    except OSError:
        os._exit(NO_PROCESS)
    if policy == 0:
        for descriptor in (options["lifeline_fd"], options["lock_fd"]):
            os.close(descriptor)
        os.setsid()
        die_with_parent(keeper)
        return
    hide_memory()
    for descriptor in (options["report_fd"], options["stack_fd"]):
        os.close(descriptor)
    statuses: dict[int, int | None] = {policy: None}
    try:
        _wait(policy, options["lifeline_fd"], statuses)
        _kill_all(policy, statuses, alone=alone)
        status = statuses[policy]
        # The harness reads to the end of what the policy prints.
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(nowhere, descriptor)
        with suppress(OSError):  # The harness may be gone.
            os.write(options["lifeline_fd"], str(-signal.SIGKILL if status is None else status).encode())
        os.close(options["lifeline_fd"])
        # Here and not in the harness, which may end at any moment, and has other things to do if this takes long.
        become_remover(Path(os.environ["TMPDIR"]))
    except BaseException:
        _pass_on(signal.SIGKILL, policy, statuses)
        raise


def _refused(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError as error:
        return isinstance(error, PermissionError)
    return False


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


def _kill_all(policy: int, statuses: dict[int, int | None], *, alone: bool) -> None:
    """Kill what is left of what the policy started, itself included.

    ``alone``: whether the kernel lets this process signal nothing but that.
    """
    if sys.platform != "linux":  # Nothing there tells whose children they are.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(policy, signal.SIGKILL)
    if alone:
        # The kernel starts no process while it sends this, so that none escapes by forking, however many fork.
        with suppress(ProcessLookupError, PermissionError):
            os.kill(-1, signal.SIGKILL)
    kill_children(statuses)
