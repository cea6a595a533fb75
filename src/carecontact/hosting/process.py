"""A policy in a process of its own: started, spoken to under deadlines, always reaped."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import carecontact
from carecontact.errors import PolicyError
from carecontact.hosting.conversation import BUDGET_S, GRACE_S, PolicyConversation, readable
from carecontact.hosting.descendants import MARK, kill_marked, new_mark
from carecontact.hosting.wire.client import PolicyClient
from carecontact.policies.language import LANGUAGE_VARIABLE, RECORD_VARIABLE
from carecontact.policies.registry import resolve_policy

OUTPUT_BYTES = 8192
"""Of what the policy printed, the end that is kept as evidence."""

ENVIRONMENT = (
    "PATH", "HOME", "TMPDIR", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "CUDA_VISIBLE_DEVICES", "SSL_CERT_FILE",
    "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY", "http_proxy", "https_proxy", "no_proxy",
    LANGUAGE_VARIABLE, RECORD_VARIABLE,
)  # fmt: skip
ENVIRONMENT_PREFIXES = ("OMP_", "OPENBLAS_", "OPENAI_")
"""Nothing else reaches the policy: no variable of the harness can carry a seed or a label."""

_BOOTSTRAP = """
import json, sys
options = json.loads(sys.argv[1])
if options["root"] not in sys.path:
    sys.path.insert(0, options["root"])
from carecontact.hosting.child import main
main(options["target"], options["search_path"], report_fd=options["report_fd"], lifeline_fd=options["lifeline_fd"])
"""


class PolicyProcess(PolicyConversation):
    """A conversation with a policy whose process it starts, and leaves no process behind."""

    def __init__(
        self,
        policy: str,
        *,
        first_deadline_s: float,
        deadline_s: float,
        budget_s: float = BUDGET_S,
        search_path: Sequence[str] = (),
    ) -> None:
        """``policy``: a registered name or ``module:Class``, looked up in ``search_path`` first.

        Raises UnknownNameError or ConfigError.
        """
        super().__init__(policy, first_deadline_s=first_deadline_s, deadline_s=deadline_s, budget_s=budget_s)
        self._target = resolve_policy(policy)
        self._search_path = [os.path.abspath(p) for p in search_path]
        self._child: subprocess.Popen[bytes] | None = None
        self._mark = new_mark()
        self._lifeline: int | None = None
        self._output = b""
        self._reader: threading.Thread | None = None

    @property
    def printed(self) -> str:
        return readable(self._output.decode(errors="replace")).strip()

    def launch(self) -> int:
        """The port of the loopback interface where the policy waits for whoever speaks to it instead of this object.

        Raises PolicyError as ``start`` does.
        """
        deadline = time.monotonic() + self._first_deadline_s
        with self._evidence("start"):
            return self._launch(lambda: max(deadline - time.monotonic(), 0.0))

    def close(self) -> None:
        if self._client is not None and self._child is not None and self._child.poll() is None:
            self._client.say_goodbye(deadline_s=GRACE_S)
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(GRACE_S)
        self._drop()

    def _open(self, left: Callable[[], float]) -> PolicyClient:
        """Launch, import, connect."""
        port = self._launch(left)
        return PolicyClient(port=port, deadline_s=left())

    def _launch(self, left: Callable[[], float]) -> int:
        """The port on which the child listens."""
        report_read, report_write = os.pipe()
        lifeline_read, self._lifeline = os.pipe()
        options: dict[str, Any] = {
            "root": str(Path(carecontact.__file__).resolve().parents[1]),
            "target": self._target,
            "search_path": self._search_path,
            "report_fd": report_write,
            "lifeline_fd": lifeline_read,
        }
        try:
            # -s -P and no PYTHON* variable isolate as -I does, but leave PYTHONHASHSEED, without which the order of a
            # set, and so a policy's answer, may differ from run to run.
            self._child = subprocess.Popen(
                [sys.executable, "-s", "-P", "-u", "-c", _BOOTSTRAP, json.dumps(options)],
                env=_environment() | {MARK: self._mark},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(report_write, lifeline_read),
                start_new_session=True,
            )
        except OSError as error:
            os.close(report_read)
            raise PolicyError("start", f"no process could be started: {error}") from None
        finally:
            os.close(report_write)
            os.close(lifeline_read)
        self._reader = threading.Thread(target=self._drain, args=(self._child,), daemon=True)
        self._reader.start()
        with os.fdopen(report_read, "rb", buffering=0) as report:
            line = b""
            while not line.endswith(b"\n"):
                if not select.select([report], [], [], left())[0]:
                    raise PolicyError("timeout", f"not loaded within {self._first_deadline_s:g} s")
                piece = report.read(65536)
                if not piece:
                    raise PolicyError("start", "the process ended before it listened")
                line += piece
        told = json.loads(line)
        if "error" in told:
            raise PolicyError("start", f"could not load {self._target}:\n{told['error']}")
        return int(told["port"])

    def _drain(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdout is not None
        while piece := os.read(child.stdout.fileno(), 65536):
            self._output = (self._output + piece)[-OUTPUT_BYTES:]

    def _how_it_ended(self) -> str:
        if self._child is None:
            return ""
        try:
            code = self._child.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            return " (its process still runs)"
        if code < 0:
            with suppress(ValueError):
                return f" (killed by {signal.Signals(-code).name})"
        return f" (exit code {code})"

    def _kill(self) -> None:
        """Nothing that the policy started outlives it."""
        if self._child is not None:
            # First, while parents live by whom their children are known; the group is for systems without /proc.
            kill_marked(self._mark)
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._child.pid, signal.SIGKILL)

    def _drop(self) -> None:
        self._kill()
        child, lifeline = self._child, self._lifeline
        self._child = self._lifeline = None
        if child is not None:
            child.wait()
        if self._reader is not None:
            self._reader.join(GRACE_S)
        if lifeline is not None:
            os.close(lifeline)
        super()._drop()


def _environment() -> dict[str, str]:
    allowed = {k: v for k, v in os.environ.items() if k in ENVIRONMENT or k.startswith(ENVIRONMENT_PREFIXES)}
    # One thread: the fastest for small arrays, and the only count whose floating-point sums are the same everywhere.
    return {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"} | allowed | {"PYTHONHASHSEED": "0"}
