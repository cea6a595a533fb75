from __future__ import annotations

import struct
import subprocess
import sys

import pytest

from carecontact.hosting.isolation import system_calls
from carecontact.hosting.isolation.fence import level
from carecontact.hosting.isolation.system_calls import ALLOW, AT_LEAST, EQUAL, LOAD, REFUSE, RETURN

ITSELF_AND_ITS_PARENT = """
import fcntl, os, resource, subprocess, sys, time
from carecontact.hosting.isolation.system_calls import filter_calls
print(filter_calls())
resource.setrlimit(resource.RLIMIT_NOFILE, (100, 100))
print(subprocess.check_output(["sh", "-c", "ulimit -n"], text=True).strip())
file = open(sys.executable, "rb")
print(all(time.clock_gettime(clock) > 0 for clock in (0, 1, time.CLOCK_PROCESS_CPUTIME_ID)))
print(fcntl.fcntl(file, fcntl.F_GETFD), fcntl.fcntl(file, fcntl.F_GETLEASE) == fcntl.F_UNLCK)
for refused in (
    lambda: resource.prlimit(os.getppid(), resource.RLIMIT_NOFILE),
    lambda: fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK),
    lambda: time.clock_gettime(~os.getppid() << 3 | 2),
):
    try:
        refused()
    except PermissionError:
        print("refused")
"""


@pytest.mark.skipif(not system_calls.can_filter_calls(), reason="this system does not filter system calls")
def test_a_process_keeps_the_harmless_uses_of_a_call() -> None:
    told = subprocess.check_output([sys.executable, "-c", ITSELF_AND_ITS_PARENT], text=True)
    assert told.split() == ["True", "100", "True", "1", "True", *["refused"] * 3]


def test_without_it_isolation_is_not_full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_calls, "SECCOMP", {})
    assert not system_calls.can_filter_calls()
    assert not system_calls.filter_calls()
    assert level(6, calls=True) == "full"
    assert level(6, calls=False).startswith("partial: ")


@pytest.mark.parametrize("machine", system_calls.ARCHITECTURES)
def test_every_architecture_of_a_machine_is_filtered(machine: str) -> None:
    """The programs are interpreted here, since no machine runs all of them."""
    audited = system_calls.ARCHITECTURES[machine]
    program = b"".join(system_calls._section(*each) for each in audited.items())  # pyright: ignore[reportPrivateUsage]
    program += system_calls._step(RETURN, ALLOW)  # pyright: ignore[reportPrivateUsage]
    fcntl = {"x86_64": 72, "x32": 72 | 1 << 30, "i386": 221, "aarch64": 25, "arm": 221}
    prlimit = {"x86_64": 302, "x32": 302 | 1 << 30, "i386": 340, "aarch64": 261, "arm": 369}
    watch = {"x86_64": 254, "x32": 254 | 1 << 30, "i386": 292, "aarch64": 27, "arm": 317}
    clock = {"x86_64": 228, "x32": 228 | 1 << 30, "i386": 403, "aarch64": 113, "arm": 403}
    ring = {name: 425 | (1 << 30 if name == "x32" else 0) for name in audited}
    for name, number in audited.items():
        for call, first, second, expected in (
            (fcntl[name], 3, 1024, REFUSE), (fcntl[name], 3, 1026, REFUSE), (fcntl[name], 3, 1040, REFUSE),
            (fcntl[name], 3, 1030, ALLOW), (fcntl[name], 1024, 3, ALLOW), (prlimit[name], 0, 7, ALLOW),
            (prlimit[name], 7, 0, REFUSE), (watch[name], 0, 0, REFUSE), (9999, 1024, 1024, ALLOW),
            (ring[name], 1, 0, REFUSE), (clock[name], 1 << 31, 0, REFUSE),
            (clock[name], 0xFFFF_FFFE, 0, REFUSE), (clock[name], 11, 0, ALLOW),
        ):  # fmt: skip
            seen = struct.pack("=iIQ6Q", call, number, 0, first, second, 0, 0, 0, 0)
            assert _decided(program, seen) == expected, (name, call, first, second)


def _decided(program: bytes, seen: bytes) -> int:
    steps, at, loaded = list(struct.iter_unpack("=HBBI", program)), 0, 0
    while True:
        code, then, otherwise, value = steps[at]
        at += 1
        if code == LOAD:
            (loaded,) = struct.unpack_from("=I", seen, value)
        elif code == EQUAL:
            at += then if loaded == value else otherwise
        elif code == AT_LEAST:
            at += then if loaded >= value else otherwise
        else:
            assert code == RETURN
            return value
