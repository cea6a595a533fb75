"""Runs a policy in a process of its own: starts it isolated, talks to it under deadlines, says why it ended, and always
ends it."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import carecontact
from carecontact.errors import ExhaustedError, PolicyError, StorageError, UnreachableError
from carecontact.policies.registry import policy_target
from carecontact.serving.client import PolicyClient
from carecontact.serving.connection import Connection
from carecontact.serving.conversation import GRACE_S, Left, PolicyConversation, PolicySetup
from carecontact.serving.namespaces import SANDBOX, granted
from carecontact.serving.process_tree import ASK, STACK_PATIENCE_S, read_stack, readable_descriptors
from carecontact.serving.sandbox import ENDING_S, NO_PROCESS, REMOVAL_S, PrivateFolder, private_folder
from carecontact.system import cache_folder, is_exhausted

REPORT_BYTES = 1 << 20
"""Most bytes of what the process reports about its start; a traceback is its longest part."""
OUTPUT_BYTES = 8192
"""Number of bytes of the policy's output that are kept as evidence: its last ones."""
ENVIRONMENT = frozenset(
    "PATH HOME TMPDIR LANG LC_ALL LD_LIBRARY_PATH CUDA_VISIBLE_DEVICES SSL_CERT_FILE "
    "HTTP_PROXY HTTPS_PROXY NO_PROXY http_proxy https_proxy no_proxy".split()
)
ENVIRONMENT_PREFIXES = ("OMP_", "OPENBLAS_")
"""Besides these, only variables that --policy-env names reach the policy, so that no variable of the harness can carry
a seed or a label."""
LANGUAGE_PREFIX = "OPENAI_"
"""Variables with the address and key of a language model; only a policy that the user lets use ``live:MODEL`` gets
them."""
SECRET_CHARS = 6
"""A value of --policy-env of at least this length is removed from the policy's output. Shorter values may be ordinary
words."""
TOO_MANY_FILES = (errno.EMFILE, errno.ENFILE)
"""Errors that neither the policy nor the temporary folder causes."""

_MISSING_KEY = re.compile(r"KeyError: '([A-Za-z_][A-Za-z0-9_]*)'")
_DENIED = re.compile(
    r"(?:Permission denied|No such file or directory): *['\"]([^'\"\n]+)"
    r"|(/[^'\"\n:]+)['\"]?: (?:Permission denied|No such file or directory)"
)
_BOOTSTRAP = """
import json, sys
options = json.load(sys.stdin)
if options["root"] not in sys.path:
    sys.path.insert(0, options["root"])
# Before importing numpy, which starts threads: neither a fork nor isolation reaches threads that already run.
from carecontact.serving.sandbox import start
start(options)
from carecontact.serving.child import main
main(options)
"""


def remedy(message: str, *, isolation: str | None) -> str:
    """Return what to append to a failure caused by a path that the harness can use and its policy cannot, or nothing.
    ``isolation``: in the words of recordings."""
    denied = _DENIED.search(message)
    if denied is None or not isolation or isolation.startswith("none"):
        return ""
    path = os.path.realpath(denied[1] or denied[2])
    missing = "No such file" in denied[0]  # Namespaces hide what lies in /tmp.
    if not os.access(path if os.path.exists(path) or missing else os.path.dirname(path), os.R_OK):
        return ""
    return (
        f"; policies are isolated and this file is closed to them: --policy-read {path} lets the policy read it, and "
        "--policy-write lets it write there"
    )


class PolicyProcess(PolicyConversation):
    """A conversation with a policy in a process that this object starts; it leaves no process behind."""

    def __init__(self, setup: PolicySetup, *, first_deadline_s: float, deadline_s: float) -> None:
        """``setup``: the setup of a registered or importable policy. Raises UnknownNameError for an unknown one."""
        super().__init__(setup.ref.text, first_deadline_s=first_deadline_s, deadline_s=deadline_s)
        self._target = policy_target(setup.ref)
        self._setup = setup
        self._child: subprocess.Popen[bytes] | None = None
        """The process that watches the policy's (``serving.sandbox``)."""
        self._lifeline: socket.socket | None = None
        """That process ends with it, and reports over it how the policy's process ended."""
        self._line: socket.socket | None = None
        """The end of the connection from which alone the policy accepts one."""
        self._folder: PrivateFolder | None = None
        self._stack: int | None = None
        self._output = b""
        self._reader: threading.Thread | None = None
        self._owned = ExitStack()
        """What is closed when the process has ended."""

    @property
    def printed(self) -> str:
        return self._shown(self._output.decode(errors="replace")).strip()

    def launch(self) -> socket.socket:
        """Start the process and return a connection to its policy, which the caller closes. Raises as ``start``."""
        return self._call("start", self._first_deadline_s, lambda left: self._reached(self._launch(left), left))

    def hung(self) -> str:
        """Return the stack of a launched policy whose connection is closed and that does not end; else empty."""
        self._ended_within(GRACE_S)
        return self._shown(self._where("timeout"))

    def close(self) -> None:
        if self._client is not None and not self._ended_within(0.0):
            self._client.say_goodbye(deadline_s=GRACE_S)
            self._ended_within(GRACE_S)
        self._drop()

    def _open(self, left: Left) -> PolicyClient:
        port = self._launch(left)
        try:
            return PolicyClient(Connection.open(port=port, deadline_s=left(), line=self._reached(port, left)))
        except UnreachableError as error:
            raise PolicyError("died", str(error)) from None

    def _reached(self, port: int, left: Left) -> socket.socket:
        """Connect to the port where the policy listens, from the only port that it accepts."""
        line, self._line = self._line, None
        assert line is not None
        line.settimeout(left())
        try:
            line.connect(("127.0.0.1", port))
        except OSError as error:
            line.close()
            raise PolicyError("died", f"its process took no connection: {error.strerror or error}") from None
        line.settimeout(None)
        return line

    def _launch(self, left: Left) -> int:
        """Start the child process and return the port on which it listens."""
        namespaces = self._setup.isolated and granted()
        self._folder = None if namespaces else _new_folder()
        self._line = self._owned.enter_context(socket.socket())
        self._line.bind(("127.0.0.1", 0))
        with ExitStack() as theirs:
            report, report_write = os.pipe()
            self._owned.callback(os.close, report)
            theirs.callback(os.close, report_write)
            self._stack, stack_write = os.pipe()
            self._owned.callback(os.close, self._stack)
            theirs.callback(os.close, stack_write)
            self._lifeline, lifeline = socket.socketpair()
            self._owned.enter_context(self._lifeline)
            theirs.enter_context(lifeline)
            descriptors = {
                "report_fd": report_write,
                "stack_fd": stack_write,
                "lifeline_fd": lifeline.fileno(),
                "lock_fd": None if self._folder is None else self._folder.lock,
            }
            self._child = self._popen([fd for fd in descriptors.values() if fd is not None])
        try:
            reader = threading.Thread(target=self._drain, args=(self._child,), daemon=True)
            reader.start()
            self._reader = reader
        except RuntimeError as error:
            self._child.kill()  # It waits for its options, and has started nothing.
            raise _exhausted(error) from None
        options = _options(self._setup, self._target) | descriptors
        options |= {"harness_port": self._line.getsockname()[1], "namespaces": namespaces}
        # Not on the command line, which every user of the machine can read. The policy's own code runs after this.
        assert self._child.stdin is not None
        with suppress(BrokenPipeError), self._child.stdin as stdin:
            stdin.write(json.dumps(options).encode())
        return self._reported_port(report, left)

    def _popen(self, descriptors: Sequence[int]) -> subprocess.Popen[bytes]:
        folder = {} if self._folder is None else {"TMPDIR": str(self._folder.path)}
        # -s -P and no PYTHON* variable isolate as -I does, but leave PYTHONHASHSEED, without which the order of a set,
        # and so a policy's answer, may differ from run to run.
        try:
            return subprocess.Popen(
                [*shlex.split(os.environ.get(SANDBOX, "")), sys.executable, "-s", "-P", "-u", "-c", _BOOTSTRAP],
                env=_environment(self._setup) | dict(self._setup.environment) | folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=descriptors,
                start_new_session=True,
            )
        except OSError as error:
            if error.errno in TOO_MANY_FILES:
                raise
            if is_exhausted(error):
                raise _exhausted(error) from None
            raise PolicyError("start", f"no process could be started: {error}") from None

    def _reported_port(self, report: int, left: Left) -> int:
        lines = self._report_lines(report, left)
        try:
            self.isolation = str(json.loads(next(lines))["isolation"])
            if sandbox := os.environ.get(SANDBOX):
                level, *opened = self.isolation.split("; ", 1)
                self.isolation = "; ".join([f"{level}, in {sandbox}", *opened])
            found: dict[str, Any] = json.loads(next(lines))
            if "error" not in found:
                port = found["port"]
                if type(port) is not int or not 0 < port < 1 << 16:
                    raise ValueError
                return port
            kind, why = found["kind"], str(found["error"])
        except (ValueError, TypeError, KeyError, RecursionError):
            # A policy that wrote this must not turn its failure into one of the harness, after which it is run again.
            raise PolicyError("garbage", "its process reported neither a port nor why it did not start") from None
        raise PolicyError(kind if kind in ("argument", "start") else "start", why)

    def _report_lines(self, report: int, left: Left) -> Iterator[bytes]:
        """Yield the lines that the process reports about its start; raise if it ends before the last one."""
        written = b""
        while True:
            *lines, written = written.split(b"\n")
            yield from lines
            if not readable_descriptors([report], left()):
                raise PolicyError(
                    "timeout", f"the policy was not ready within {self._first_deadline_s:g} s of its start"
                )
            piece = os.read(report, 65536)
            if not piece:
                if self.isolation is None and self._watchers_status() == NO_PROCESS:
                    raise _exhausted(self.printed or "no process or memory is left")
                raise PolicyError("start", self._how_it_ended("before it was ready"))
            written += piece
            if len(written) > REPORT_BYTES:
                raise PolicyError("oversize", f"its process reported more than {REPORT_BYTES} bytes at its start")

    def _watchers_status(self) -> int | None:
        """Return the exit status of the process that watches, which is about to end; None if it does not."""
        assert self._child is not None
        assert self._reader is not None
        self._reader.join(GRACE_S)  # What it printed says why.
        with suppress(subprocess.TimeoutExpired):
            return self._child.wait(GRACE_S)
        return None

    def _drain(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdout is not None
        while piece := os.read(child.stdout.fileno(), 65536):
            self._output = (self._output + piece)[-OUTPUT_BYTES:]

    def _shown(self, text: str) -> str:
        for value in self._setup.environment.values():
            if len(value) >= SECRET_CHARS:
                text = text.replace(value, "[secret removed]")
        return super()._shown(text)

    def _cause(self, error: PolicyError) -> tuple[str, str, str]:
        """The kind is ``killed`` if the process received SIGKILL, whose sender is unknown."""
        if self._child is None:
            return error.kind, "", ""
        kind = error.kind
        if kind in ("died", "start", "handshake"):
            with suppress(TimeoutError):
                # If the process that watches it is gone, the kernel has killed it.
                if self._status() in (None, -signal.SIGKILL):
                    kind = "killed"
        end = self._how_it_ended() if kind in ("died", "killed") else ""
        return kind, end, self._where(error.kind)

    def _ended_within(self, time_s: float) -> bool:
        """Wait for the end of the policy's process; also true if there is none."""
        return self._lifeline is None or bool(readable_descriptors([self._lifeline.fileno()], time_s))

    def _status(self) -> int | None:
        """Return the exit status of the policy's process; None if the process that watches it ended without a report.
        Raises TimeoutError if neither happens."""
        assert self._lifeline is not None
        if not self._ended_within(GRACE_S):
            raise TimeoutError
        return _reported(self._lifeline)

    def _how_it_ended(self, when: str = "without an answer") -> str:
        assert self._child is not None
        try:
            code = self._status()
        except TimeoutError:
            return f"it closed its connection {when}, and its process still runs"
        if code is None:
            return f"its process was killed {when}, because the process that watches it {_ended_as(self._child.wait())}"
        return f"its process {_ended_as(code)} {when}"

    def _where(self, kind: str) -> str:
        if self._child is None or self._stack is None or kind not in ("timeout", "died", "start"):
            return ""
        hangs = kind == "timeout" and not self._ended_within(0.0)
        if hangs:
            self._child.send_signal(ASK)
        frames = read_stack(self._stack, patience_s=STACK_PATIENCE_S if hangs else 0.0)
        return f"\nit {'hung' if hangs else 'crashed'} here (most recent call last):\n{frames}" if frames else ""

    def _hint(self, message: str) -> str:
        """Explain a missing variable or file that the harness has: the policy cannot know that it was withheld."""
        missing = _MISSING_KEY.search(message)
        passes = {*_environment(self._setup), *self._setup.environment}
        if missing is None or missing[1] not in os.environ or missing[1] in passes:
            return remedy(message, isolation=self.isolation)
        return f"; {missing[1]} is set here, but reaches the policy only with --policy-env {missing[1]}"

    def _kill(self) -> None:
        """Have the process and everything that the policy started killed, and its folder removed."""
        if self._child is None or self._lifeline is None:
            return
        with suppress(OSError):
            self._lifeline.shutdown(socket.SHUT_WR)
        if not self._ended_within(ENDING_S):
            self._child.kill()
        reported = _reported(self._lifeline) is not None
        with suppress(subprocess.TimeoutExpired):
            self._child.wait(REMOVAL_S)
        if reported and self._folder is not None:
            # The other process has removed it, or goes on with that alone.
            self._folder.release()
            self._folder = None

    def _drop(self) -> None:
        self._kill()
        super()._drop()
        if self._reader is not None:
            self._reader.join(GRACE_S)
        if self._folder is not None:
            self._folder.remove()
        self._child = self._lifeline = self._line = self._folder = self._stack = None
        self._owned.close()


def _new_folder() -> PrivateFolder:
    try:
        return private_folder()
    except OSError as error:
        if error.errno in TOO_MANY_FILES:
            raise
        raise StorageError(
            f"no temporary folder can be made for the policy's process: {error}; mend that, or name another folder in "
            "the variable TMPDIR, then give the same command again"
        ) from None


def _exhausted(why: object) -> ExhaustedError:
    return ExhaustedError(f"the policy's process could not be started: {why}")


def _reported(lifeline: socket.socket) -> int | None:
    """Return the exit status that was reported, or None if it ended without a report."""
    with suppress(OSError, ValueError):
        return int(lifeline.recv(16, socket.MSG_PEEK | socket.MSG_DONTWAIT))
    return None


def _ended_as(code: int) -> str:
    if code >= 0:
        return f"ended itself with exit code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


def _options(setup: PolicySetup, target: str) -> dict[str, object]:
    """Return the part of the ``child.Options`` that the setup decides."""

    def absolute(places: Iterable[str]) -> list[str]:
        return [os.path.abspath(place) for place in places]

    return {
        "root": str(Path(carecontact.__file__).resolve().parents[1]),
        "target": target,
        "search_path": absolute(setup.search_path),
        "arguments": dict(setup.arguments),
        "language": {name: text for name in ("language", "record") if (text := getattr(setup, name)) is not None},
        "environment": list(setup.environment),
        "readable": absolute(setup.readable),
        "writable": absolute(setup.writable),
        "closed": absolute((*setup.closed, *map(str, filter(None, [cache_folder()])))),
        "isolated": setup.isolated,
    }


def _environment(setup: PolicySetup) -> dict[str, str]:
    language = setup.language or setup.arguments.get("language", "")
    prefixes = (*ENVIRONMENT_PREFIXES, *([LANGUAGE_PREFIX] if language.startswith("live:") else []))
    allowed = {k: v for k, v in os.environ.items() if k in ENVIRONMENT or k.startswith(prefixes)}
    # One thread: the fastest for small arrays, and the only count whose floating-point sums are the same everywhere.
    return {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"} | allowed | {"PYTHONHASHSEED": "0"}
