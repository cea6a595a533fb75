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
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import carecontact
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard, Session
from carecontact.errors import PolicyError
from carecontact.policies.language import LANGUAGE_VARIABLE, RECORD_VARIABLE
from carecontact.policies.registry import resolve_policy
from carecontact.policies.wire.client import ActReply, PolicyClient

GRACE_S = 1.0
"""Between being asked to end and being killed."""
OUTPUT_BYTES = 8192
"""Of what the policy printed, the end that is kept as evidence."""
EVIDENCE_CHARS = 4000

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
from carecontact.policies.child import main
main(options["target"], options["search_path"], report_fd=options["report_fd"], lifeline_fd=options["lifeline_fd"])
"""


class PolicyProcess:
    """Context manager around one policy process, for one trial.

    Every method below raises PolicyError (``kind`` says what happened, the message ends with what the policy printed)
    and leaves no process behind. After a failure the object is closed.
    """

    def __init__(
        self, policy: str, *, first_deadline_s: float, deadline_s: float, search_path: Sequence[str] = ()
    ) -> None:
        """``policy``: a registered name or ``module:Class``, looked up in ``search_path`` first.

        ``first_deadline_s`` holds for the start, each reset and the first act, when models load; ``deadline_s`` for
        every later act. Raises UnknownNameError or ConfigError.
        """
        self.policy = policy
        self._target = resolve_policy(policy)
        self._first_deadline_s, self._deadline_s = first_deadline_s, deadline_s
        self._search_path = [os.path.abspath(p) for p in search_path]
        self._acted = False
        self._child: subprocess.Popen[bytes] | None = None
        self._client: PolicyClient | None = None
        self._lifeline: int | None = None
        self._output = b""
        self._reader: threading.Thread | None = None

    def __enter__(self) -> PolicyProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    @property
    def printed(self) -> str:
        """The end of what the policy wrote to stdout and stderr; complete once the process is closed."""
        return self._output.decode(errors="replace").strip()

    def start(self) -> PolicyCard:
        """Launch, import, connect; returns the policy's card."""
        deadline = time.monotonic() + self._first_deadline_s

        def left() -> float:
            return max(deadline - time.monotonic(), 0.0)

        with self._evidence("start"):
            port = self._launch(left)
            self._client = PolicyClient(port=port, deadline_s=left())
            return self._client.card(deadline_s=left())

    def reset(self, instruction: str, session: Session) -> None:
        with self._evidence("reset"):
            self._connected().reset(instruction, session, deadline_s=self._first_deadline_s)

    def act(self, observation: Observation) -> ActReply:
        """One observation, one checked chunk. ObservationError and ContractError are the harness's own mistakes."""
        deadline_s = self._deadline_s if self._acted else self._first_deadline_s
        self._acted = True
        with self._evidence("act"):
            return self._connected().act(observation, deadline_s=deadline_s)

    def close(self) -> None:
        """End the process, gracefully if it still answers. Idempotent."""
        if self._client is not None and self._child is not None and self._child.poll() is None:
            self._client.say_goodbye(deadline_s=GRACE_S)
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(GRACE_S)
        self._kill_and_reap()

    def _connected(self) -> PolicyClient:
        if self._client is None:
            raise RuntimeError("PolicyProcess: start() comes first, and nothing comes after a failure or close()")
        return self._client

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
                env=_environment(),
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

    @contextmanager
    def _evidence(self, doing: str) -> Generator[None, None, None]:
        """Whatever goes wrong inside ends the process; a PolicyError leaves with what is known about why."""
        try:
            yield
        except PolicyError as error:
            ended = self._how_it_ended() if error.kind in ("died", "start") else ""
            self._kill_and_reap()
            message = f"policy {self.policy!r} failed at {doing}: {str(error)[:EVIDENCE_CHARS]}{ended}"
            if self.printed:
                message += f"\nit printed last:\n{self.printed[-EVIDENCE_CHARS // 2 :]}"
            raise PolicyError(error.kind, message, notes=error.notes) from None
        except BaseException:
            self._kill_and_reap()
            raise

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
        """The whole process group, so that nothing that the policy started outlives it."""
        if self._child is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._child.pid, signal.SIGKILL)

    def _kill_and_reap(self) -> None:
        self._kill()
        client, child, lifeline = self._client, self._child, self._lifeline
        self._client = self._child = self._lifeline = None
        if child is not None:
            child.wait()
        if self._reader is not None:
            self._reader.join(GRACE_S)
        if lifeline is not None:
            os.close(lifeline)
        if client is not None:
            # Its other end is gone, and websockets may trip over what a dying process left on the line.
            with suppress(Exception):
                client.disconnect()


def _environment() -> dict[str, str]:
    allowed = {k: v for k, v in os.environ.items() if k in ENVIRONMENT or k.startswith(ENVIRONMENT_PREFIXES)}
    # One thread: the fastest for small arrays, and the only count whose floating-point sums are the same everywhere.
    return {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"} | allowed | {"PYTHONHASHSEED": "0"}
