"""What a policy's process may read and write: what programs need, and what belongs to the policy.

By Landlock, a process gives up rights to files and signals for itself and its descendants, without needing a privilege.
Numbers are those of linux/landlock.h. A policy's process isolates itself as far as the system can, before anything else
is imported there.
"""

from __future__ import annotations

import ctypes
import glob
import importlib.util
import os
import stat
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec, PathFinder
from importlib.util import spec_from_file_location
from types import ModuleType
from typing import TYPE_CHECKING

from carecontact.serving.namespaces import SHARED_MEMORY, granted
from carecontact.system import drop_capabilities

if TYPE_CHECKING:
    from carecontact.serving.child import Options


CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
"""System calls, with the same numbers on every architecture that Python runs on."""
VERSION_FLAG, PATH_BENEATH = 1, 1
NO_NEW_PRIVS = 38
"""linux/prctl.h"""

EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
REMOVE_AND_MAKE = sum(1 << bit for bit in range(4, 13))
"""Remove a directory or file; make a device, directory, file, socket, pipe or link."""
REFER, TRUNCATE, IOCTL_DEVICE, RESOLVE_SOCKET = 1 << 13, 1 << 14, 1 << 15, 1 << 16
"""Rights of later versions. The last one is to connect to a socket with a path that another process made."""
SINCE = {2: REFER, 3: TRUNCATE, 5: IOCTL_DEVICE, 9: RESOLVE_SOCKET}
"""Version of Landlock -> the right that this version is the first to control."""
TRUNCATE_SINCE, SCOPES_SINCE = 3, 6
ABSTRACT_SOCKETS, SIGNALS = 1 << 0, 1 << 1

READ = EXECUTE | READ_FILE | READ_DIR
WRITE = WRITE_FILE | REMOVE_AND_MAKE | REFER | TRUNCATE
DEVICE = READ_FILE | WRITE_FILE | IOCTL_DEVICE
OF_A_FILE = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEVICE | RESOLVE_SOCKET
"""Rights that a rule about anything other than a directory may contain."""

SYSTEM = (
    *"/usr /bin /sbin /lib /lib32 /lib64 /opt /nix/store /sys /run/systemd/resolve".split(),
    *"/etc/alternatives /etc/ca-certificates /etc/pki /etc/ssl /etc/fonts /etc/OpenCL /etc/vulkan /etc/glvnd".split(),
    *"/etc/mime.types /etc/ld.so.cache /etc/ld.so.conf /etc/ld.so.conf.d /etc/ld.so.preload /etc/locale.alias".split(),
    *"/etc/localtime /etc/timezone /etc/os-release /etc/passwd /etc/group /etc/nsswitch.conf /etc/host.conf".split(),
    *"/etc/hosts /etc/resolv.conf /etc/gai.conf /etc/services /etc/protocols".split(),
)
"""What programs need to read: programs, libraries, hardware, certificates and names of hosts. Never /home, /root, /tmp,
/run or all of /etc."""
CLOCKS = (
    *"/sys/fs/cgroup /sys/kernel/debug /sys/kernel/tracing /sys/devices/virtual/powercap /sys/kernel/irq".split(),
    *(f"/sys/devices/system/cpu/cpu*/{name}" for name in ("cpuidle", "cpufreq/stats", "acpi_cppc")),
)
"""Parts of SYSTEM that count what others use of the processors: time, to a microsecond or better, cycles, energy and
interrupts."""
LIMITS = tuple(
    f"/sys/fs/cgroup/{name}"
    for name in "cpu.max cpu/cpu.cfs_quota_us cpu/cpu.cfs_period_us memory.max memory/memory.limit_in_bytes".split()
)
"""Files among these that libraries read to learn how many threads to start; joblib fails if it cannot open the first
one although it exists."""
PROCESS = tuple(f"/proc/{name}" for name in "cpuinfo meminfo version filesystems devices modules sys driver".split())
"""The parts of /proc that describe the machine. Of the processes in it, a policy sees only its own. Never stat, uptime
or loadavg: stat shows contact by how much processor time the simulator takes (docs/evidence/threat-model.md)."""
CACHE_VARIABLES = ("~/.cache",)
"""Folders in which libraries keep downloaded weights."""
KEYS = ("~/.cache/huggingface/token", "~/.cache/huggingface/stored_tokens")
"""Secrets of the user inside these folders."""
SOCKETS = ("/run/systemd/resolve", "/run/nscd", "/run/nvidia-persistenced")
"""Sockets of the daemons that resolve names of hosts and keep graphics cards initialised."""
DEVICES = tuple(f"/dev/{name}" for name in "null zero full random urandom nvidia* dri kfd dxg infiniband".split())
CACHE_FOLDERS = (
    *("TRITON_HOME", "TRITON_CACHE_DIR", "CUPY_CACHE_DIR", "CUDA_CACHE_PATH", "MPLCONFIGDIR", "NUMBA_CACHE_DIR"),
    "HF_TOKEN_PATH",
)
"""Variables that name folders in which libraries keep compiled files and, in the last one, look for a key of the user.
By default these lie in the home folder, and some libraries fail if they cannot use it."""
NAME_FILES = ("LD_LIBRARY_PATH", "SSL_CERT_FILE")
"""Usual variables that name files."""

_PINNED: list[int] = []
"""Open descriptors of the places in /proc that rules name. Without them, the kernel may recreate such a place, and the
rule would no longer apply to it."""


def version() -> int:
    """Return the kernel's version of Landlock, 0 where it has none or forbids it."""
    if sys.platform != "linux":
        return 0
    return max(_call(CREATE_RULESET, None, 0, VERSION_FLAG), 0)


def restrict(rights: Mapping[str, int]) -> int:
    """Take from this process every right to files that ``rights`` (path -> rights beneath it) does not give.

    It also takes signals and abstract sockets to processes that this process did not start. The restriction applies to
    the calling thread and to those that it starts, so call it before there is another thread. Paths that do not exist
    are skipped. Returns the kernel's version of Landlock; 0 means that nothing was restricted.
    """
    kernel = version()
    if not kernel:
        return 0
    handled = READ | WRITE_FILE | REMOVE_AND_MAKE | sum(right for since, right in SINCE.items() if kernel >= since)
    # An older kernel refuses unknown fields unless they are 0.
    scopes = ABSTRACT_SOCKETS | SIGNALS if kernel >= SCOPES_SINCE else 0
    attributes = struct.pack("=QQQ", handled, 0, scopes)
    ruleset = _call(CREATE_RULESET, attributes, len(attributes), 0)
    if ruleset < 0:
        return 0
    try:
        for path, allowed in rights.items():
            with suppress(OSError):
                _add(ruleset, path, allowed & handled)
        no_new_privileges = ctypes.CDLL(None).prctl(NO_NEW_PRIVS, 1, 0, 0, 0) == 0
        return kernel if no_new_privileges and _call(RESTRICT_SELF, ruleset, 0) == 0 else 0
    finally:
        os.close(ruleset)


def _add(ruleset: int, path: str, allowed: int) -> None:
    place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        if not stat.S_ISDIR(os.fstat(place).st_mode):
            allowed &= OF_A_FILE
        if allowed:
            _call(ADD_RULE, ruleset, PATH_BENEATH, struct.pack("=Qi", allowed, place), 0)
    finally:
        if path.startswith("/proc/"):
            _PINNED.append(place)
        else:
            os.close(place)


def _call(number: int, *arguments: int | bytes | None) -> int:
    """Make a system call. A number is passed as a long, because the kernel reads all 64 bits of some arguments."""
    passed = [ctypes.c_long(a) if isinstance(a, int) else a for a in arguments]
    libc = ctypes.CDLL(None)
    libc.syscall.restype = ctypes.c_long
    return libc.syscall(ctypes.c_long(number), *passed)


@dataclass(frozen=True, kw_only=True)
class Allowed:
    """What a policy's process may use."""

    places: tuple[str, ...]
    """Files and folders as the policy may name them; some may lie in ``/tmp``."""
    rights: dict[str, int]
    """Path -> rights, as ``restrict`` takes them, without those of the running process (``own_rights``)."""


def allowed(options: Options) -> Allowed:
    """Find what a policy's process may use, before namespaces hide anything.

    Besides what programs need, it may read its modules, whose package may lie elsewhere, as with an editable
    installation; and every path, alone or in a list, in its arguments and in the variables that name files. Folders of
    ``closed`` stay closed even inside one that may be read; only ``readable`` opens them.
    """
    record, readable, writable = options["language"].get("record"), options["readable"], options["writable"]
    variables = [os.environ[name] for name in (*options["environment"], *NAME_FILES) if name in os.environ]
    given = [*options["arguments"].values(), *options["language"].values(), *variables]
    if record is not None:
        # A single file can be opened to the policy only if it exists.
        with suppress(OSError):
            open(record, "ab").close()
    keys = [path for path in map(os.path.expanduser, KEYS) if os.path.exists(path)]
    shut = [os.path.realpath(path) for path in (*options["closed"], *keys, *_found(CLOCKS))]
    home = os.path.realpath(os.path.expanduser("~"))
    hidden = list[str]()
    with suppress(OSError):
        hidden = [os.path.join(home, name) for name in os.listdir(home) if name.startswith(".")]
    places = [*SYSTEM, *PROCESS, *map(os.path.expanduser, CACHE_VARIABLES), *_interpreter()]
    places += [*_package(options["search_path"], options["target"]), *options["search_path"], *_paths(given)]
    found = Counter[str]()

    def allow(paths: Iterable[str], right: int) -> None:
        for path in paths:
            found[path] |= right

    for place in map(os.path.realpath, places):
        # A folder that holds the whole home folder does not open the keys that programs keep hidden there.
        allow(without(place, [*shut, *hidden] if _inside(home, place) else shut), READ)
    allow(filter(os.path.exists, LIMITS), READ)
    allow(_found(DEVICES), READ | DEVICE)
    allow(map(os.path.realpath, SOCKETS), RESOLVE_SOCKET)
    records = [record] if record is not None else []
    allow(records, READ_FILE | WRITE_FILE)
    allow(readable, READ)
    allow(writable, READ | WRITE | DEVICE | RESOLVE_SOCKET)
    return Allowed(places=(*places, *readable, *writable, *records), rights=dict(found))


def _found(patterns: Iterable[str]) -> list[str]:
    return [path for pattern in patterns for path in glob.glob(pattern)]


def own_rights(closed: Sequence[str]) -> dict[str, int]:
    """Return path -> rights of what belongs to the running process: its entry in ``/proc``, temporary files and shared
    memory, unless one of these folders is in it.
    """
    # CUDA names its threads there and does not start unless it may truncate the file to which it writes a name.
    own = {f"/proc/{os.getpid()}": READ | WRITE_FILE | TRUNCATE}
    shut = [os.path.realpath(path) for path in closed]
    places = (tempfile.gettempdir(), SHARED_MEMORY)
    return own | {place: READ | WRITE for place in places if list(without(place, shut)) == [place]}


def without(folder: str, closed: Sequence[str]) -> Iterator[str]:
    """Yield ``folder``; if closed folders lie inside it, its other content instead; if it is closed, nothing."""
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
            else:
                real = os.path.realpath(path)
                if not any(_inside(shut, real) or _inside(real, shut) for shut in closed):
                    yield path


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


class UnlistedFolders(MetaPathFinder):
    """A finder for the end of ``sys.meta_path`` that imports from a folder that may not be listed because something in
    it is closed to the policy. Python's own finder lists a folder first; this one asks for one file.
    """

    def __init__(self, folders: Sequence[str]) -> None:
        self._folders = folders

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """Find a top-level module; None for others, because Python's own finder sees what lies in a package."""
        for folder in self._folders if path is None else ():
            package = os.path.join(folder, fullname)
            if os.path.isfile(start := os.path.join(package, "__init__.py")):
                return spec_from_file_location(fullname, start, submodule_search_locations=[package])
            for file in (package + suffix for suffix in (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)):
                if os.path.isfile(file):
                    return spec_from_file_location(fullname, file)
            if os.path.isdir(package):
                space = ModuleSpec(fullname, None, is_package=True)
                space.submodule_search_locations = [package]
                return PathFinder.find_spec(fullname, [folder]) or space
        return None


def level(kernel: int, *, namespaces: bool) -> str:
    """Describe the isolation that a version of Landlock gives, with or without namespaces; version 0 is a kernel
    without it.

    The first word of the description is the level: full, partial or none.
    """
    around = f"{'with' if namespaces else 'without'} namespaces"
    if not kernel:
        missing = "Landlock (Linux 5.13), or this system forbids it"
        return f"partial: namespaces without {missing}" if namespaces else f"none: neither namespaces nor {missing}"
    if kernel < TRUNCATE_SINCE:
        return f"partial: Landlock {around}, and emptying a file is open (Linux 6.2)"
    if namespaces:
        return "full: namespaces and Landlock"
    if kernel < SCOPES_SINCE:
        return f"partial: Landlock {around}, and signals to the harness are open (Linux 6.12)"
    return f"partial: Landlock {around}"


def available() -> str:
    """Return the description (``level``) of the isolation that this system can give a policy."""
    return level(version(), namespaces=granted())


def closes_signals() -> bool:
    """Whether an isolated policy has no means to send the harness a signal."""
    return granted() or version() >= SCOPES_SINCE


def isolate(options: Options, allowed: Allowed | None) -> None:
    """Give up all rights that a policy does not need; none if ``allowed`` is None.

    Afterwards, ``options["isolation"]`` describes the level and what the user opened, in the words of recordings.
    """
    if allowed is None:
        options["isolation"] = "none: switched off"
        return
    for name in CACHE_FOLDERS:
        os.environ.setdefault(name, os.path.join(tempfile.gettempdir(), name.lower()))
    drop_capabilities()
    kernel = restrict(allowed.rights | own_rights(options["closed"]))
    reached = level(kernel, namespaces=options["namespaces"])
    # The policy can read these options, and the names of the folders show where the run is stored.
    options["closed"] = []
    folders = (*options["search_path"], *sys.path)
    if unlisted := [folder for folder in folders if os.path.isdir(folder) and not _listed(folder)]:
        sys.meta_path.append(UnlistedFolders(unlisted))
    for word, paths in (("read", options["readable"]), ("write", options["writable"])):
        if paths:
            reached += f"; --policy-{word} {' '.join(paths)}"
    options["isolation"] = reached


def _listed(folder: str) -> bool:
    try:
        os.listdir(folder)
    except PermissionError:
        return False
    return True
