"""Recognises errors of a policy about a file that isolation closes to it."""

from __future__ import annotations

import os
import re

_DENIED = re.compile(r"Permission denied: *['\"]([^'\"\n]+)|(/[^'\"\n:]+)['\"]?: Permission denied")


def remedy(message: str, *, isolation: str | None) -> str:
    """Return what to append to a failure caused by a path that the harness can use and its policy cannot; otherwise
    empty.

    ``isolation``: the isolation of the policy's process, in the words of recordings.
    """
    denied = _DENIED.search(message)
    if denied is None or not isolation or isolation.startswith("none"):
        return ""
    path = os.path.realpath(denied[1] or denied[2])
    if not os.access(path if os.path.exists(path) else os.path.dirname(path), os.R_OK):
        return ""
    return (
        f"; policies are isolated and this file is closed to them: --policy-read {path} lets the policy read it, and "
        "--policy-write lets it write there"
    )
