"""The process between the harness and the policy's: it closes off what the policy does not need, starts the policy's
process by a fork, and reports how that ended. It imports nothing that starts a thread.

With it ends everything that the policy started: in namespaces, the kernel does that; elsewhere, this process adopts and
kills what is left (``serving.process_tree``). It ends when the policy does, and when the harness closes its end of a
socket, which the kernel does for a harness that is killed.
"""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.serving.fence import allowed, isolate
from carecontact.serving.namespaces import SHARED_MEMORY, enter, mount_processes, start_init
from carecontact.serving.process_tree import ASK, CHILDREN_PATIENCE_S, kill_children, readable_descriptors, reap
from carecontact.system import NO_LOCKS, adopt_orphans, die_with_parent

if TYPE_CHECKING:
    from carecontact.serving.child import Options


PREFIX = "carecontact-policy-"
BESIDE_SHARED_MEMORY = "/tmp"
"""Where the folders lie if TMPDIR is in shared memory, which every policy may read and write."""
REMOVAL_S = 10.0
"""Longest wait [s] for the removal of a policy's folder when the policy has ended: it may have left so many files that
this takes minutes, and then goes on beside the next trial."""
ABANDONED_S = 1.0
"""Longest wait [s] for the removal of all folders that killed harnesses left: the deadline of another policy pays for
it."""
ENDING_S = CHILDREN_PATIENCE_S + 1.0
"""Longest wait [s] of the harness for the end of this process."""
NO_PROCESS = os.EX_OSERR
"""Exit status if the policy's process cannot be started."""
UNMOVED_BY = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that all processes of a command may receive when it is stopped. This one ends with the harness anyway, and
before that it has to kill what the policy started."""
# The second attempt is for a folder without the right to list it.
_REMOVE = ("sh", "-c", 'rm -rf -- "$0" 2>/dev/null || { chmod -R u+rwx -- "$0"; rm -rf -- "$0"; }')


@dataclass(frozen=True, kw_only=True)
class PrivateFolder:
    """A policy's temporary folder on the disk, where its temporary files are not in a namespace's memory."""

    path: Path
    lock: int
    """Descriptor of the lock, which the kernel releases when the last process that has it ends in any way."""

    def remove(self, *, wait_s: float | None = REMOVAL_S) -> None:
        """Remove the folder, whatever a policy made in it, and release the lock. It may go on after the wait."""
        try:
            self.path.rmdir()  # This needs no file descriptor, where too many may be open.
        except FileNotFoundError:
            pass
        except OSError:
            # What cannot be removed now is found as abandoned later.
            with suppress(OSError, subprocess.TimeoutExpired):
                subprocess.Popen([*_REMOVE, str(self.path)], pass_fds=[self.lock], start_new_session=True).wait(wait_s)
        self.release()

    def release(self) -> None:
        """Leave the folder to another process that has the lock."""
        os.close(self.lock)


def private_folder() -> PrivateFolder:
    """Make a folder, after removing those whose harness is gone. Raises OSError if none can be made.

    Where the file system has no locks, an abandoned folder looks like one in use: it is left there.
    """
    remove_abandoned_folders()
    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=_place()))
        try:
            made = PrivateFolder(path=path, lock=_locked(path, otherwise_open=True))
        except (FileNotFoundError, BlockingIOError):
            continue  # Between making and locking the folder, another harness removes it as an abandoned one.
        except OSError:  # Too many open files, for example.
            path.rmdir()
            raise
        if path.is_dir():
            return made
        made.remove()


def remove_abandoned_folders() -> None:
    """Remove the folders of policies whose harness was killed. It may go on after ABANDONED_S."""
    until = time.monotonic() + ABANDONED_S
    for path in _place().glob(f"{PREFIX}*"):
        with suppress(OSError):
            PrivateFolder(path=path, lock=_locked(path)).remove(wait_s=max(0.0, until - time.monotonic()))


def _place() -> Path:
    place = Path(tempfile.gettempdir()).resolve()
    return Path(BESIDE_SHARED_MEMORY) if place.is_relative_to(SHARED_MEMORY) else place


def _locked(path: Path, *, otherwise_open: bool = False) -> int:
    """Lock a folder and return the descriptor, without a lock if ``otherwise_open`` where the file system has none.
    Raises BlockingIOError while another process holds the lock."""
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if not (otherwise_open and error.errno in NO_LOCKS):
            os.close(lock)
            raise
    return lock


def start(options: Options) -> None:
    """Divide this process, which has one thread, in two: one waits and never returns from here, and the other, the
    policy's, is isolated and returns."""
    own = os.getpid()
    # The harness's parent may have changed these, and neither of the two processes works with blocked signals.
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    rights = allowed(options) if options["isolated"] else None
    init, held = None, None
    try:
        if options["namespaces"]:
            assert rights is not None
            os.environ["TMPDIR"] = enter(rights.places)
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
        isolate(options, rights)
        return
    for descriptor in (options["report_fd"], options["stack_fd"]):
        os.close(descriptor)
    _watch(policy, init, options["lifeline_fd"])
    if options["lock_fd"] is not None:
        # Here and not in the harness, which may end at any moment, and has other things to do if this takes long.
        PrivateFolder(path=Path(os.environ["TMPDIR"]), lock=options["lock_fd"]).remove(wait_s=None)
    os._exit(0)


def _watch(policy: int, init: int | None, lifeline: int) -> None:
    """Wait for the end of the policy or of the harness, kill what the policy started, and report how it ended."""
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
        ready = readable_descriptors([lifeline, woken], 0.0 if more else None)
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
