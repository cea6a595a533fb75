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
"""The request's ``told_fd`` in a forked worker; the socket has this number in the server."""
NEEDED = (
    "carecontact.running.trial", "carecontact.serving.process", "carecontact.scoring.score", "h5py", "numpy.ma",
    "numpy.random",
)  # fmt: skip
"""Modules that a worker would import."""


def main() -> None:
    die_with_parent(int(sys.argv[1]))
    own = os.getpid()
    line = socket.socket(fileno=os.dup(0))
    assert line.fileno() == STATUS_FD
    prepare()
    alive: dict[int, tuple[int, int]] = {}
    while True:
        ready = readable_descriptors([STATUS_FD, *alive])
        for descriptor in ready:
            if descriptor in alive:
                pid, news = alive.pop(descriptor)
                os.write(news, PROCESS_STATUS.pack(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])))
                os.close(news)
                os.close(descriptor)
                continue
            message, given, _, _ = socket.recv_fds(line, 1, 4)
            if not message:
                return
            try:
                pid = os.fork()
            except OSError as error:
                os.write(given[-1], PROCESS_STATUS.pack(-(error.errno or errno.EAGAIN)))
                for other in given:
                    os.close(other)
                continue
            if pid == 0:
                line.detach()
                for mine, news in alive.items():
                    os.close(mine)
                    os.close(news[1])
                os._exit(work(given, server=own))
            # The supervisor kills a worker together with what that started.
            os.setpgid(pid, pid)
            for other in given[:-1]:
                os.close(other)
            os.write(given[-1], PROCESS_STATUS.pack(pid))
            alive[os.pidfd_open(pid)] = (pid, given[-1])


def prepare() -> None:
    """Raises RuntimeError where a fork would leave threads behind."""
    for name in NEEDED:
        import_module(name)
    from carecontact.human.library import body_names, load_body
    from carecontact.sensing.keypoints import import_pose
    from carecontact.sim.opengl import import_opengl

    import_pose()
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
    """Run a worker with the descriptors of its standard input, its output, what it tells and its news; returns its exit
    status. ``server``: the id of the process that forked it."""
    requests, output, told, news = given
    for source, target in ((requests, 0), (output, 1), (output, 2), (told, STATUS_FD)):
        os.dup2(source, target, inheritable=target < STATUS_FD)
    for descriptor in (requests, output, told, news):
        os.close(descriptor)
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
