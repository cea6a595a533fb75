"""The keeper of a policy: the process between the harness and the policy's process, which it starts by a fork.

Every process that the policy starts stays below the keeper, because the keeper adopts those whose own parent ends
(Linux). When the policy ends, or the harness closes its lifeline or is killed, the keeper kills them all, and then ends
as the policy did: with the same exit code, or by the same signal.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from carecontact.hosting.descendants import PATIENCE_S, kill_children
from carecontact.hosting.isolation.private_folder import remove_if_abandoned
from carecontact.hosting.stack import ASK
from carecontact.own_process import adopt_orphans, die_with_parent, hide_memory

if TYPE_CHECKING:
    from carecontact.hosting.child import Options

KEEPER_S = PATIENCE_S + 1.0
"""Longest wait [s] of the harness for a keeper that shall end."""
UNMOVED_BY = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that whoever stops a command may send to all its processes. The keeper ends with the command anyway, and
before that it has to kill what the policy started."""


def keep(options: Options) -> None:
    """Divide this process, which has one thread, into the keeper, which never returns from here, and the policy's
    process, which does.
    """
    keeper, harness = os.getpid(), os.getppid()
    adopt_orphans()
    policy = os.fork()
    if policy == 0:
        os.close(options["lifeline_fd"])
        os.setsid()
        die_with_parent(keeper)
        return
    hide_memory()
    for descriptor in (options["report_fd"], options["stack_fd"]):
        os.close(descriptor)
    try:
        status = _watch(policy, options["lifeline_fd"])
        if os.getppid() != harness:
            remove_if_abandoned(Path(os.environ["TMPDIR"]))
    except BaseException:
        os.kill(policy, signal.SIGKILL)
        raise
    _end_as(status)


def _watch(policy: int, lifeline: int) -> int:
    """Return the policy's exit status, as ``subprocess.Popen.returncode``, when nothing is left of what it started."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(ASK, lambda *_: os.kill(policy, ASK))
    for number in UNMOVED_BY:
        signal.signal(number, signal.SIG_IGN)
    ended: dict[int, int] = {}
    while policy not in ended and lifeline not in select.select([lifeline, woken], [], [])[0]:
        os.read(woken, 4096)
        _reap(ended)
    if sys.platform != "linux":  # Nothing there tells whose children they are.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(policy, signal.SIGKILL)
    until = time.monotonic() + PATIENCE_S
    while _reap(ended) and time.monotonic() < until:
        kill_children(but=())
    return ended.get(policy, -signal.SIGKILL)


def _reap(ended: dict[int, int]) -> bool:
    """Add the ids and exit statuses of the children that have ended; return whether any child is left."""
    with suppress(ChildProcessError):
        while (found := os.waitpid(-1, os.WNOHANG))[0]:
            ended[found[0]] = os.waitstatus_to_exitcode(found[1])
        return True
    return False


def _end_as(status: int) -> NoReturn:
    if status < 0:
        with suppress(OSError, ValueError):
            signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    os._exit(status if status >= 0 else 1)
