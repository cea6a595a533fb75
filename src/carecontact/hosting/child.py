"""What the policy's process does: raise the wall, load the policy, say the port, serve, end with its parent."""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import sys
import threading
from typing import cast

from carecontact.contract.policy import Policy
from carecontact.hosting.wall import raise_wall
from carecontact.hosting.wire.server import serve_policy, told

_PR_SET_PDEATHSIG = 1
"""linux/prctl.h"""


def main(target: str, search_path: list[str], *, report_fd: int, lifeline_fd: int) -> None:
    """Serve ``module:Class``. Writes one JSON line to ``report_fd``: ``{"port": n}`` or ``{"error": text}``."""
    _die_with_parent()
    threading.Thread(target=_end_with_parent, args=(lifeline_fd,), daemon=True).start()
    with os.fdopen(report_fd, "w") as report:
        try:
            raise_wall()
            sys.path[:0] = search_path
            policy = _load(target)
        except (Exception, SystemExit) as error:
            report.write(json.dumps({"error": told(error)}) + "\n")
            return

        def tell(port: int) -> None:
            report.write(json.dumps({"port": port}) + "\n")
            report.close()

        serve_policy(policy, on_port=tell)


def _load(target: str) -> Policy:
    module, _, name = target.partition(":")
    loaded = importlib.import_module(module)
    try:
        factory = getattr(loaded, name)
    except AttributeError:
        classes = [n for n, v in vars(loaded).items() if isinstance(v, type) and hasattr(v, "act")]
        raise ImportError(f"{module} has no {name!r}; it has {', '.join(classes) or 'no class with act'}") from None
    policy = factory()
    missing = [method for method in ("reset", "act") if not callable(getattr(policy, method, None))]
    if missing:
        raise TypeError(f"{target} has no method {' or '.join(missing)}; a policy has card, reset and act")
    return cast(Policy, policy)


def _die_with_parent() -> None:
    """SIGKILL from the kernel, which also ends a policy that has stopped itself and so hears no pipe."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))


def _end_with_parent(lifeline_fd: int) -> None:
    """The parent never writes; the read returns when the parent is gone, even if the policy hangs."""
    os.read(lifeline_fd, 1)
    os._exit(1)
