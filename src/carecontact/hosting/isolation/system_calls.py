"""A filter of system calls (seccomp) against what Landlock leaves open.

With these calls a policy could act on the trial's process or watch it, because both belong to the same user. It could
set that process's resource limits, so that the kernel kills it; lower its priority at the disk; take a lease on a file
that the next trial opens, so that the trial waits for 45 s and tells that it opened the file; watch which files the
harness makes; read how much processor time that process has used, which is more in contact; receive the kernel's
messages about processes that start and end (the process connector, a netlink socket); or have a ring of operations
(io_uring) do such things, which this filter does not see.

Numbers are those of linux/seccomp.h, linux/filter.h, linux/audit.h and of each architecture's table of system calls."""

from __future__ import annotations

import ctypes
import errno
import os
import struct
import sys
from dataclasses import dataclass

NO_NEW_PRIVS, SET_SECCOMP = 38, 22
"""linux/prctl.h"""
FILTER, GET_ACTION_AVAIL = 2, 2
SECCOMP = {"x86_64": 317, "aarch64": 277}
"""Machine -> number of the system call."""
LOAD, EQUAL, AT_LEAST, RETURN = 0x20, 0x15, 0x35, 0x06
CALL_AT, ARCHITECTURE_AT, ARGUMENTS_AT, ARGUMENT_BYTES = 0, 4, 16, 8
"""Offsets in ``struct seccomp_data``. Both machines are little-endian: the lower half of an argument comes first."""
REFUSE, ALLOW = 0x00050000 | errno.EPERM, 0x7FFF0000

X32 = 1 << 30
ARCHITECTURES = {
    "x86_64": {"x86_64": 0xC000003E, "x32": 0xC000003E, "i386": 0x40000003},
    "aarch64": {"aarch64": 0xC00000B7, "arm": 0x40000028},
}
"""Machine -> the architectures whose programs it runs, as linux/audit.h numbers them."""


@dataclass(frozen=True, kw_only=True)
class Refused:
    """A system call that the filter refuses."""

    numbers: dict[str, int]
    """Architecture -> number of the call; one without it is not filtered. That of x32 follows from x86_64's."""
    argument: int = 0
    only: tuple[int, ...] = ()
    """Values of the argument with which the call is refused; none: it is refused with every value."""
    unless: int | None = None
    """The value of the argument with which the call is allowed."""
    at_least: int | None = None
    """The lowest value of the argument, without a sign, with which the call is refused."""

    def steps(self) -> list[bytes]:
        """Return the instructions that decide about this call; the last one is a return in every case."""
        if self.at_least is not None:
            argument = _step(LOAD, ARGUMENTS_AT + ARGUMENT_BYTES * self.argument)
            compared = _step(AT_LEAST, self.at_least, then=1)
            return [argument, compared, _step(RETURN, ALLOW), _step(RETURN, REFUSE)]
        values = self.only if self.unless is None else (self.unless,)
        if not values:
            return [_step(RETURN, REFUSE)]
        equal, other = (REFUSE, ALLOW) if self.unless is None else (ALLOW, REFUSE)
        # Where a value is the argument, skip the other comparisons and the first return.
        compared = [_step(EQUAL, value, then=len(values) - i) for i, value in enumerate(values)]
        argument = _step(LOAD, ARGUMENTS_AT + ARGUMENT_BYTES * self.argument)
        return [argument, *compared, _step(RETURN, other), _step(RETURN, equal)]


TELLS_OR_HOLDS = (1024, 1026, 1040)
"""Commands of ``fcntl`` (linux/fcntl.h): take a lease on a file (F_SETLEASE), be told of what happens in a folder
(F_NOTIFY), take a lease on a folder (F_SETDELEG)."""

CLOCKS_OF_OTHERS = 1 << 31
"""linux/posix-timers.h: the number of a clock is negative where it is the processor time of a process."""

PROCESS_CONNECTOR = 11
"""Protocol of a netlink socket (NETLINK_CONNECTOR of linux/netlink.h); no other family has a protocol of this number
that a process without privileges may use."""

CALLS = (
    # prlimit64. A process that calls itself 0 sets its own limits.
    Refused(numbers={"x86_64": 302, "i386": 340, "aarch64": 261, "arm": 369}, unless=0),
    # fcntl and fcntl64
    Refused(numbers={"x86_64": 72, "i386": 55, "aarch64": 25, "arm": 55}, argument=1, only=TELLS_OR_HOLDS),
    Refused(numbers={"i386": 221, "arm": 221}, argument=1, only=TELLS_OR_HOLDS),
    # socket. Programs for i386 that call socketcall, which hides the arguments in memory, get no socket.
    Refused(numbers={"x86_64": 41, "i386": 359, "aarch64": 198, "arm": 281}, argument=2, only=(PROCESS_CONNECTOR,)),
    Refused(numbers={"i386": 102}),
    # io_uring_setup: operations of a ring, such as making a socket, are no system calls, and nothing filters them.
    Refused(numbers={"x86_64": 425, "i386": 425, "aarch64": 425, "arm": 425}),
    # inotify_add_watch, fanotify_init, ioprio_set
    Refused(numbers={"x86_64": 254, "i386": 292, "aarch64": 27, "arm": 317}),
    Refused(numbers={"x86_64": 300, "i386": 338, "aarch64": 262, "arm": 367}),
    Refused(numbers={"x86_64": 251, "i386": 289, "aarch64": 30, "arm": 314}),
    # timer_create, clock_gettime, clock_nanosleep, and the last two with times of 64 bits
    Refused(numbers={"x86_64": 222, "i386": 259, "aarch64": 107, "arm": 257}, at_least=CLOCKS_OF_OTHERS),
    Refused(numbers={"x86_64": 228, "i386": 265, "aarch64": 113, "arm": 263}, at_least=CLOCKS_OF_OTHERS),
    Refused(numbers={"x86_64": 230, "i386": 267, "aarch64": 115, "arm": 265}, at_least=CLOCKS_OF_OTHERS),
    Refused(numbers={"i386": 403, "arm": 403}, at_least=CLOCKS_OF_OTHERS),
    Refused(numbers={"i386": 407, "arm": 407}, at_least=CLOCKS_OF_OTHERS),
)


def can_filter_calls() -> bool:
    """Whether this system filters system calls."""
    number = SECCOMP.get(os.uname().machine) if sys.platform == "linux" else None
    action = ctypes.byref(ctypes.c_uint32(REFUSE & 0xFFFF0000))
    return number is not None and ctypes.CDLL(None).syscall(number, GET_ACTION_AVAIL, 0, action) == 0


def filter_calls() -> bool:
    """Refuse the calls in CALLS to this process. Return whether that worked.

    The filter applies to the calling thread and to all that it starts, so call this before there is another thread.
    """
    if not can_filter_calls():
        return False
    sections = [_section(name, audited) for name, audited in ARCHITECTURES[os.uname().machine].items()]
    steps = b"".join([*sections, _step(RETURN, ALLOW)])
    code = ctypes.create_string_buffer(steps, len(steps))
    program = struct.pack("@HP", len(steps) // 8, ctypes.addressof(code))
    prctl = ctypes.CDLL(None).prctl
    return prctl(NO_NEW_PRIVS, 1, 0, 0, 0) == 0 and prctl(SET_SECCOMP, FILTER, program, 0, 0) == 0


def _section(architecture: str, audited: int) -> bytes:
    """Return the instructions for the programs of one architecture; those of another one go on after them."""
    body = [_step(LOAD, CALL_AT)]
    for call in CALLS:
        numbers = call.numbers | ({"x32": call.numbers["x86_64"] | X32} if "x86_64" in call.numbers else {})
        if architecture in numbers:
            decided = call.steps()
            body += [_step(EQUAL, numbers[architecture], otherwise=len(decided)), *decided]
    return b"".join([_step(LOAD, ARCHITECTURE_AT), _step(EQUAL, audited, otherwise=len(body)), *body])


def _step(code: int, value: int, *, then: int = 0, otherwise: int = 0) -> bytes:
    """Return one instruction. ``then``, ``otherwise``: number of instructions to skip after a comparison."""
    return struct.pack("=HBBI", code, then, otherwise, value)
