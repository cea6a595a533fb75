"""A policy that tries to reach what it must not, and says what it got."""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.serving.fence import CACHE_FOLDERS

SEIZE = 0x4206
"""linux/ptrace.h"""
PROCESS_VM_READV, PIDFD_GETFD = 310, 438
IN_CREATE = 0x100
"""linux/inotify.h"""
BEST_EFFORT = 2 << 13 | 4
"""linux/ioprio.h, the class and value that processes have."""
UNLIMITED = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
SIZE = ctypes.c_size_t


def tries(folder: Path, socket_name: str, harness: int) -> dict[str, Callable[[], object]]:
    """``folder`` holds the policy's own folder, with the runs and the kept arrays in it, and a file of the user's
    outside of it. ``harness``: process id, as ``Leaks`` takes it."""
    settled = folder / "policy" / "cache" / "settled"
    run = folder / "policy" / "runs" / "now"
    recording, package = run / "T1-s000.h5", Path(sys.modules["carecontact"].__file__ or "").parent
    temporary = Path(tempfile.gettempdir())
    of_harness = Path(f"/proc/{harness}")
    return {
        "read a recording of this run": recording.read_bytes,
        "read a recording of an earlier run": (folder / "policy/runs/earlier/T1-s000.h5").read_bytes,
        "read a recording through a child": lambda: _child(f"print(open({str(recording)!r}).read())"),
        "read a recording through /proc/self/root": Path(f"/proc/self/root{recording}").read_bytes,
        "link a recording into its own folder": lambda: os.link(recording, temporary / "linked"),
        "list the run": lambda: os.listdir(run),
        "list the folder of runs": lambda: os.listdir(run.parent),
        "list the settled persons that are kept": lambda: os.listdir(settled),
        "read a settled person": (settled / "person.npz").read_bytes,
        "read the key of the names of what is kept": (settled.parent / "secret").read_bytes,
        "write a file into the run": (run / "T1-s001.h5").touch,
        "write into a recording": lambda: recording.open("ab").close(),
        "empty a recording": lambda: os.truncate(recording, recording.stat().st_size),
        "rename a recording": lambda: (recording.rename(run / "x"), (run / "x").rename(recording)),
        "remove a file of the run": (run / "manifest.json").unlink,
        "write into the package": lambda: (package / "errors.py").open("ab").close(),
        "add a module to the package": lambda: ((package / "planted.py").touch(), (package / "planted.py").unlink()),
        "write into its own folder": (folder / "policy" / "kept").touch,
        "read a file of the user": (folder / "outside" / "secret").read_text,
        "write a file of the user": lambda: (folder / "outside" / "secret").open("ab").close(),
        "list processes in /proc": lambda: os.listdir("/proc"),
        "command line of the harness": (of_harness / "cmdline").read_bytes,
        "variables of the harness": (of_harness / "environ").read_bytes,
        "memory of the harness": lambda: (of_harness / "mem").open("rb").close(),
        "map of the harness's memory": (of_harness / "maps").read_text,
        "working folder of the harness": (of_harness / "cwd").readlink,
        "list the files that the harness holds open": lambda: os.listdir(of_harness / "fd"),
        "trace the harness": lambda: _traced(harness),
        "copy memory of the harness": lambda: _copied(harness),
        "take a descriptor of the harness": lambda: _taken(harness),
        "signal the harness": lambda: os.kill(harness, 0),
        "signal the harness through a child": lambda: _child(f"import os; os.kill({harness}, 0)"),
        "limit the files of the harness": lambda: resource.prlimit(harness, resource.RLIMIT_FSIZE, UNLIMITED),
        "limit the processor time of the harness through a child": lambda: _child(
            f"import resource; resource.prlimit({harness}, resource.RLIMIT_CPU, {UNLIMITED})"
        ),
        "connect to an abstract socket": lambda: _connected(f"\0{socket_name}"),
        "change the harness's priority at the disk": lambda: _disk_priority(harness),
        "processor time of the harness": lambda: time.clock_gettime(~harness << 3 | 2),
        "processor time of all processes, to a nanosecond": lambda: os.listdir("/sys/fs/cgroup"),
        "processor time of all processes": Path("/proc/stat").read_text,
        "load of the machine": Path("/proc/loadavg").read_text,
        "find the run's folder among its options": _named_folders,
    }


def stays_open(folder: Path, harness: int) -> dict[str, Callable[[], object]]:
    """What neither Landlock nor namespaces close, or not before Linux 7.1."""
    run, package = folder / "policy" / "runs" / "now", Path(sys.modules["carecontact"].__file__ or "").parent
    recording = run / "T1-s000.h5"
    return {
        "hold a lease on a file that the harness opens": lambda: _leased(package / "errors.py"),
        "learn the names of the run's new files": lambda: _watched(run),
        "size of a recording whose name it guesses": recording.stat,
        "change the mode of a recording": lambda: recording.chmod(0o644),
        "change the priority of the harness": lambda: os.setpriority(os.PRIO_PROCESS, harness, 0),
        "bind the harness to processors": lambda: os.sched_setaffinity(harness, os.sched_getaffinity(harness)),
        "learn that a process exists": Path(f"/proc/{harness}").stat,
        "learn how many files the harness holds open": Path(f"/proc/{harness}/fd").stat,
        "connect to a socket with a path": lambda: _connected(str(folder / "outside" / "socket")),
        "write into shared memory": _shared_memory,
        "keep something in shared memory of System V": _system_v,
        "open a connection": lambda: socket.create_server(("127.0.0.1", 0)).close(),
    }


class Leaks:
    card = PolicyCard(name="leaks")

    def __init__(self, *, socket_name: str, harness: int) -> None:
        """``harness``: process id; 0: that of the process that watches this one, or of the first in its namespace."""
        folder, harness = Path(__file__).parents[1], harness or os.getppid() or 1
        self._attempts = {**tries(folder, socket_name, harness), **stays_open(folder, harness)}

    def reset(self, instruction: str) -> None:
        results: dict[str, str] = {}
        for name, attempt in self._attempts.items():
            try:
                attempt()
                results[name] = "open"
            except OSError as error:
                results[name] = str(error)[:80]
        status = [path.read_text() for path in Path("/proc/self/task").glob("*/status")]
        lines = [dict(line.split(":\t") for line in text.splitlines() if ":\t" in line) for text in status]
        threads = [{name: fields[name] for name in ("NoNewPrivs", "CapEff")} for fields in lines]
        files = [str(p.readlink()) for p in Path("/proc/self/fd").iterdir() if p.is_symlink() and p.is_file()]
        caches = [os.environ.get(name, "").startswith(f"{tempfile.gettempdir()}/") for name in CACHE_FOLDERS]
        sys.stdout.write(json.dumps({"results": results, "threads": threads, "files": files, "caches": caches}))

    def act(self, observation: object) -> Action:
        return Action(done=True)


def _child(code: str) -> None:
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(done.stderr.strip().splitlines()[-1])


def _checked(result: int) -> int:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _libc() -> ctypes.CDLL:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.restype = libc.syscall.restype = ctypes.c_long
    return libc


def _traced(pid: int) -> None:
    """Seized, a process does not stop."""
    _checked(_libc().ptrace(SEIZE, pid, None, None))


def _copied(pid: int) -> None:
    here = ctypes.create_string_buffer(8)

    class Vector(ctypes.Structure):
        _fields_ = (("base", ctypes.c_void_p), ("length", SIZE))

    # Whatever lies there: without the right the kernel refuses before it looks (EPERM, not EFAULT).
    address = id(None)
    local, remote = Vector(ctypes.addressof(here), 8), Vector(address, 8)
    result = _libc().syscall(
        PROCESS_VM_READV, pid, ctypes.byref(local), SIZE(1), ctypes.byref(remote), SIZE(1), SIZE(0)
    )
    if result < 0 and ctypes.get_errno() == 14:
        return
    _checked(result)


def _taken(pid: int) -> None:
    handle = os.pidfd_open(pid)
    try:
        os.close(_checked(_libc().syscall(PIDFD_GETFD, handle, 0, 0)))
    finally:
        os.close(handle)


def _connected(name: str) -> None:
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(name)


def _watched(folder: Path) -> None:
    handle = _checked(_libc().inotify_init())
    try:
        _checked(_libc().inotify_add_watch(handle, os.fsencode(folder), IN_CREATE))
    finally:
        os.close(handle)


def _leased(path: Path) -> None:
    with path.open("rb") as file:
        fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)
        fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_UNLCK)


def _disk_priority(pid: int) -> None:
    number = {"x86_64": 251, "aarch64": 30}[os.uname().machine]
    _checked(_libc().syscall(number, 1, pid, BEST_EFFORT))


def _named_folders() -> None:
    if not sys.modules["carecontact.serving.child"].RECEIVED["closed"]:
        raise OSError("it names none")


def _shared_memory() -> None:
    place = Path("/dev/shm") / f"carecontact-test-{os.getpid()}"
    place.touch()
    with suppress(OSError):
        place.unlink()


def _system_v() -> None:
    libc = _libc()
    _checked(libc.shmctl(_checked(libc.shmget(0, SIZE(4096), 0o600)), 0, None))
