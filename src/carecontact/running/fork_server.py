"""A process that has imported what a trial needs, and forks it for each worker: ``python -m
carecontact.running.fork_server SUPERVISOR`` with a socket to the process SUPERVISOR as standard input.

It never learns what a trial is, so that a worker inherits nothing of another: it gets four file descriptors for each
and hands them on. It has one thread and renders nothing, so that a fork leaves nothing half done.
"""

from __future__ import annotations

import errno
import gc
import os
import socket
import struct
import sys
import traceback
from contextlib import suppress
from importlib import import_module

from carecontact.errors import DependencyError
from carecontact.running import worker
from carecontact.serving.namespaces import granted
from carecontact.serving.process_tree import readable_descriptors
from carecontact.system import die_with_parent

PROCESS_STATUS = struct.Struct("=q")
"""News of a worker, through a pipe of its own: its process id, then its exit status as
``subprocess.Popen.returncode``; or, if it could not be forked, a negative number, the error's."""
STATUS_FD = 3
"""The request's ``status_fd`` in a forked worker; the socket has this number in the server."""
NEEDED = (
    *("carecontact.running.trial", "carecontact.running.check_answers", "carecontact.serving.process"),
    *("carecontact.scoring.score", "h5py", "numpy.ma", "numpy.random"),
)


def main() -> None:
    die_with_parent(int(sys.argv[1]))
    own = os.getpid()
    line = socket.socket(fileno=os.dup(0))
    assert line.fileno() == STATUS_FD
    prepare()
    alive: dict[int, tuple[int, int]] = {}
    """Descriptor of a worker's process -> its id, and the pipe for its news."""
    while True:
        for descriptor in readable_descriptors([STATUS_FD, *alive]):
            if descriptor in alive:
                pid, news = alive.pop(descriptor)
                os.write(news, PROCESS_STATUS.pack(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])))
                _close(news, descriptor)
                continue
            message, given, _, _ = socket.recv_fds(line, 1, 4)
            if not message:
                return
            try:
                pid = os.fork()
            except OSError as error:
                os.write(given[-1], PROCESS_STATUS.pack(-(error.errno or errno.EAGAIN)))
                _close(*given)
                continue
            if pid == 0:
                line.detach()
                for theirs, (_, news) in alive.items():
                    _close(theirs, news)
                os._exit(work(given, server=own))
            # The supervisor kills a worker together with what that started.
            os.setpgid(pid, pid)
            _close(*given[:-1])
            os.write(given[-1], PROCESS_STATUS.pack(pid))
            alive[os.pidfd_open(pid)] = (pid, given[-1])


def _close(*descriptors: int) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


def prepare() -> None:
    """Raises RuntimeError where a fork would leave threads behind."""
    for name in NEEDED:
        import_module(name)
    from carecontact.human.library import body_names, load_body
    from carecontact.sensing.blazepose import import_interpreter
    from carecontact.sim.opengl import import_opengl

    import_interpreter()
    granted()
    # Every file of every body is then in memory, and what happens to it on the disk does not change this run.
    load_body(body_names()[0])
    # Where a library is missing, a trial that renders will say so.
    with suppress(DependencyError):
        import_opengl()
    if len(os.listdir("/proc/self/task")) != 1:
        raise RuntimeError("a module started a thread when it was imported")
    # What a collection in a worker would mark, the kernel would have to copy.
    gc.collect()
    gc.freeze()


def work(given: list[int], *, server: int) -> int:
    """Run a worker with the descriptors of its standard input, output, status and news; returns its exit status."""
    requests, output, status, _ = given
    for source, target in ((requests, 0), (output, 1), (output, 2), (status, STATUS_FD)):
        os.dup2(source, target, inheritable=target < STATUS_FD)
    _close(*given)
    try:
        return worker.main(server)
    except BaseException:
        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()


if __name__ == "__main__":
    main()
