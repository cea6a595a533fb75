"""Linux namespaces around a policy's process: it sees no process, shared memory or temporary file but its own.

The kernel does the rest. When the first process of a pid namespace ends, it kills all others of that namespace, however
they were started, and what they left in memory goes with the last of them: temporary files, shared memory, semaphores.

    python -I -S namespaces.py

ends with status 0 if this system grants all of them. Therefore, this module imports the standard library alone. Numbers
are those of linux/sched.h and linux/mount.h.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from functools import cache

VARIABLE = "CARECONTACT_NAMESPACES"
"""A variable for diagnostics: with the value ``off``, policies run as on a system that grants no namespaces."""
SANDBOX = "CARECONTACT_SANDBOX"
"""Variable with a command that runs what is given after it in a sandbox, such as bubblewrap. It then starts the
policies, and decides on namespaces."""
TEMPORARY, SHARED_MEMORY = "/tmp", "/dev/shm"
FOLDER = "carecontact-policy"
"""Name of the policy's own folder in TEMPORARY. The folders that are bound back there lie outside of it."""
CLONE_NEWNS, CLONE_NEWIPC, CLONE_NEWUSER, CLONE_NEWPID = 0x00020000, 0x08000000, 0x10000000, 0x20000000
MS_NOSUID, MS_NODEV, MS_NOEXEC, MS_BIND, MS_REC, MS_SLAVE = 2, 4, 8, 4096, 16384, 1 << 19
LIMIT = "size=50%"
"""Most that each file system in memory holds: half of the machine's memory, as ``/dev/shm`` usually does."""


def granted() -> bool:
    """Whether policies run in namespaces, since this system grants them."""
    return sys.platform == "linux" and os.environ.get(VARIABLE) != "off" and not os.environ.get(SANDBOX) and _tried()


@cache
def _tried() -> bool:
    """Try it, once, in a process of its own."""
    command = [sys.executable, "-I", "-S", __file__]
    try:
        return not subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=60.0).returncode
    except (OSError, subprocess.TimeoutExpired):
        return False


def enter(places: Iterable[str]) -> str:
    """Move this process into new namespaces of mounts and of shared memory, and the processes that it forks from now on
    into one of process ids. Return the folder for temporary files, which is in memory, as is ``/dev/shm``.

    Raises OSError where that fails; this process cannot go on then.

    Args:
        places: files and folders; those that lie in ``/tmp`` or ``/dev/shm`` are bound back there.
    """
    user, group = os.geteuid(), os.getegid()
    libc = ctypes.CDLL(None, use_errno=True)
    flags = CLONE_NEWNS | CLONE_NEWIPC | CLONE_NEWPID
    if libc.unshare(flags if user == 0 else flags | CLONE_NEWUSER) != 0:
        raise OSError(ctypes.get_errno(), "unshare")
    if user != 0:
        for name, line in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            with open(f"/proc/self/{name}", "w") as file:
                file.write(line)
    # What the system mounts later still appears here; what is mounted here appears nowhere else.
    _mount(None, "/", None, MS_REC | MS_SLAVE)
    wanted = {os.path.abspath(place) for place in places} | {os.path.realpath(place) for place in places}
    # A policy in /tmp itself needs everything there.
    roots = [root for root in (TEMPORARY, SHARED_MEMORY) if root not in wanted]
    inside = sorted(place for place in wanted if any(place.startswith(f"{root}/") for root in roots))
    sources: dict[str, int] = {}
    for place in inside:
        if not any(place.startswith(f"{outer}/") for outer in sources):
            with suppress(OSError):
                sources[place] = os.open(place, os.O_PATH)
    here = os.getcwd()
    for root in roots:
        _mount("tmpfs", root, "tmpfs", MS_NOSUID | MS_NODEV, f"{LIMIT},mode=1777")
    for place, source in sources.items():
        with suppress(OSError):  # As if it did not exist.
            _bind(source, place)
        os.close(source)
    # The folder that this process is in may be covered now.
    try:
        os.chdir(here)
    except OSError:
        os.chdir("/")
    if TEMPORARY not in roots:
        return SHARED_MEMORY
    own = os.path.join(TEMPORARY, FOLDER)
    os.mkdir(own, 0o700)
    return own


def start_init() -> tuple[int, int]:
    """Fork the first process of the new pid namespace; return its id and a descriptor, with whose last copy it ends.

    It reaps orphans, as the first process of a namespace has to.
    """
    end, held = os.pipe()
    init = os.fork()
    if init == 0:
        try:
            signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # The kernel then reaps them.
            os.setsid()
            os.dup2(end, 0)
            os.closerange(1, os.sysconf("SC_OPEN_MAX"))
            os.read(0, 1)
        finally:
            os._exit(0)
    os.close(end)
    return init, held


def mount_processes() -> None:
    """Show in ``/proc`` the processes of this namespace alone. The caller has to be inside of it."""
    _mount("proc", "/proc", "proc", MS_NOSUID | MS_NODEV | MS_NOEXEC)


def _bind(source: int, place: str) -> None:
    if os.path.isdir(f"/proc/self/fd/{source}"):
        os.makedirs(place, exist_ok=True)
    else:
        os.makedirs(os.path.dirname(place), exist_ok=True)
        os.close(os.open(place, os.O_CREAT | os.O_WRONLY, 0o600))
    _mount(f"/proc/self/fd/{source}", place, None, MS_BIND | MS_REC)


def _mount(source: str | None, target: str, kind: str | None, flags: int, options: str | None = None) -> None:
    given = [None if text is None else os.fsencode(text) for text in (source, target, kind, options)]
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mount(*given[:3], ctypes.c_ulong(flags), given[3]) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"mount: {os.strerror(error)}", target)


def _try() -> None:
    """Do everything once, and raise OSError if any of it is refused."""
    enter(())
    _, held = start_init()
    inside = os.fork()
    if inside == 0:
        os.close(held)
        try:
            mount_processes()
        except OSError:
            os._exit(1)
        os._exit(0)
    if os.waitpid(inside, 0)[1] != 0:
        raise OSError("mount of /proc")


if __name__ == "__main__":
    try:
        _try()
    except OSError as refused:
        sys.exit(str(refused))
