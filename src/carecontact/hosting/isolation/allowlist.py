"""Which files a policy's process may read and write: what programs need, and what belongs to the policy."""

from __future__ import annotations

import glob
import importlib.util
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from carecontact.hosting.isolation.landlock import DEVICE, READ, READ_FILE, RESOLVE_SOCKET, TRUNCATE, WRITE, WRITE_FILE
from carecontact.hosting.isolation.namespaces import SHARED_MEMORY

SYSTEM = (
    "/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/opt", "/nix/store", "/sys", "/run/systemd/resolve",
    *(f"/etc/{name}" for name in (
        "alternatives", "ca-certificates", "pki", "ssl", "fonts", "OpenCL", "vulkan", "glvnd", "mime.types",
        "ld.so.cache", "ld.so.conf", "ld.so.conf.d", "ld.so.preload", "locale.alias", "localtime", "timezone",
        "os-release", "passwd", "group", "nsswitch.conf", "host.conf", "hosts", "resolv.conf", "gai.conf", "services",
        "protocols",
    )),
)  # fmt: skip
"""What programs need to read: programs, libraries, hardware, certificates and names of hosts. Never /home, /root, /tmp,
/run or all of /etc."""
CLOCKS = (
    "/sys/fs/cgroup", "/sys/kernel/debug", "/sys/kernel/tracing", "/sys/devices/system/cpu/cpu*/cpuidle",
    "/sys/devices/system/cpu/cpu*/cpufreq/stats", "/sys/devices/system/cpu/cpu*/acpi_cppc",
    "/sys/devices/virtual/powercap", "/sys/kernel/irq",
)  # fmt: skip
"""Parts of SYSTEM that count what others use of the processors: time, to a microsecond or better, cycles, energy and
interrupts."""
LIMITS = tuple(f"/sys/fs/cgroup/{name}" for name in (
    "cpu.max", "cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us", "memory.max", "memory/memory.limit_in_bytes",
))  # fmt: skip
"""Files among these that libraries read to learn how many threads to start; joblib fails if it cannot open the first
one although it exists."""
PROCESS = (
    "/proc/cpuinfo", "/proc/meminfo", "/proc/version", "/proc/filesystems", "/proc/devices", "/proc/modules",
    "/proc/sys", "/proc/driver",
)  # fmt: skip
"""The parts of /proc that describe the machine. Of the processes in it, a policy sees only its own. Never stat, uptime
or loadavg: stat tells contact by how much processor time the simulator takes (docs/threat-model.md)."""
CACHES = ("~/.cache",)
"""Folders in which libraries keep downloaded weights."""
KEYS = ("~/.cache/huggingface/token", "~/.cache/huggingface/stored_tokens")
"""Secrets of the user inside these folders."""
SOCKETS = ("/run/systemd/resolve", "/run/nscd", "/run/nvidia-persistenced")
"""Sockets of the daemons that resolve names of hosts and keep graphics cards initialised."""
DEVICES = (
    "/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom", "/dev/nvidia*", "/dev/dri", "/dev/kfd",
    "/dev/dxg", "/dev/infiniband",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Allowed:
    """What a policy's process may use."""

    places: tuple[str, ...]
    """Files and folders as the policy may name them; some may lie in ``/tmp``."""
    rights: dict[str, int]
    """Path -> rights, as ``landlock.restrict`` takes them, without those of the running process (``own_rights``)."""


def allowed(
    *,
    search_path: Sequence[str],
    target: str,
    given: Iterable[str],
    readable: Sequence[str],
    writable: Sequence[str],
    closed: Sequence[str],
    record: str | None = None,
) -> Allowed:
    """Find what a policy's process may use; call it where all files of the system can be seen.

    Args:
        search_path: folders of the policy's modules, besides those of ``sys.path``.
        target: ``module:Class``; its package may lie elsewhere, as with an editable installation.
        given: arguments and values of variables; every path in them, alone or in a list, may be read.
        readable, writable: files and folders that the user opened in addition.
        record: file to which the policy may append.
        closed: folders that stay closed even inside one that may be read. Only ``readable`` opens them.
    """
    found: dict[str, int] = {}

    def allow(path: str, right: int) -> None:
        found[path] = found.get(path, 0) | right

    keys = [path for path in map(os.path.expanduser, KEYS) if os.path.exists(path)]
    clocks = [path for pattern in CLOCKS for path in glob.glob(pattern)]
    shut = [os.path.realpath(path) for path in (*closed, *keys, *clocks)]
    places = [*SYSTEM, *PROCESS, *map(os.path.expanduser, CACHES), *_interpreter(), *_package(search_path, target)]
    home = os.path.realpath(os.path.expanduser("~"))
    places += [*search_path, *_paths(given)]
    for place in map(os.path.realpath, places):
        # A folder that holds the whole home folder does not open the keys that programs keep hidden there.
        for path in without(place, [*shut, *_hidden(home)] if _inside(home, place) else shut):
            allow(path, READ)
    for path in filter(os.path.exists, LIMITS):
        allow(path, READ)
    for path in (path for pattern in DEVICES for path in glob.glob(pattern)):
        allow(path, READ | DEVICE)
    for place in SOCKETS:
        allow(os.path.realpath(place), RESOLVE_SOCKET)
    if record is not None:
        allow(record, READ_FILE | WRITE_FILE)
    for path in readable:
        allow(path, READ)
    for path in writable:
        allow(path, READ | WRITE | DEVICE | RESOLVE_SOCKET)
    given_places = (*readable, *writable, *filter(None, [record]))
    return Allowed(places=(*places, *given_places), rights=found)


def own_rights(closed: Sequence[str]) -> dict[str, int]:
    """Return path -> rights of what belongs to the running process: its entry in ``/proc``, temporary files and shared
    memory.

    ``closed``: as ``allowed`` takes it; shared memory with such a folder in it stays closed.
    """
    # CUDA names its threads there and does not start unless it may truncate the file to which it writes a name.
    own = {f"/proc/{os.getpid()}": READ | WRITE_FILE | TRUNCATE}
    shut = [os.path.realpath(path) for path in closed]
    places = (tempfile.gettempdir(), SHARED_MEMORY)
    return own | {place: READ | WRITE for place in places if list(without(place, shut)) == [place]}


def without(folder: str, closed: Sequence[str]) -> Iterator[str]:
    """Yield ``folder``; if closed folders lie inside it, yield its other content instead; if it is closed, yield
    nothing.
    """
    if any(_inside(folder, shut) for shut in closed):
        return
    if not any(_inside(shut, folder) for shut in closed):
        yield folder
        return
    with suppress(OSError):
        for entry in sorted(os.listdir(folder)):
            path = os.path.join(folder, entry)
            # A link to a parent folder would make the walk endless.
            if not os.path.islink(path):
                yield from without(path, closed)
            elif not any(_inside(a, b) for shut in closed for a, b in _both(shut, os.path.realpath(path))):
                yield path


def _hidden(folder: str) -> list[str]:
    with suppress(OSError):
        return [os.path.join(folder, name) for name in os.listdir(folder) if name.startswith(".")]
    return []


def _both(one: str, other: str) -> tuple[tuple[str, str], tuple[str, str]]:
    return (one, other), (other, one)


def _inside(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip("/") + "/")


def _interpreter() -> list[str]:
    return [place for place in (*sys.path, sys.prefix, sys.base_prefix, os.path.dirname(sys.executable)) if place]


def _package(search_path: Sequence[str], target: str) -> list[str]:
    """Return where the import system finds the policy's module. A top-level module is found without running it."""
    sys.path[:0] = search_path
    try:
        spec = importlib.util.find_spec(target.partition(":")[0].partition(".")[0])
    except Exception:
        return []
    finally:
        del sys.path[: len(search_path)]
    if spec is None:
        return []
    return [*(spec.submodule_search_locations or ()), *([spec.origin] if spec.has_location and spec.origin else [])]


def _paths(given: Iterable[str]) -> Iterator[str]:
    """Yield what may be a path in each text: the text, what follows a ``name:`` in it, and the parts of a list."""
    for text in given:
        for part in {text, text.partition(":")[2], *text.split(os.pathsep)}:
            place = os.path.expanduser(part)
            with suppress(ValueError, OSError):
                if part and os.path.exists(place):
                    yield place
