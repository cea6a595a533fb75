"""Recognises errors of a policy about a file that isolation closes to it."""

from __future__ import annotations

import os
import re

_DENIED = re.compile(
    r"(?:Permission denied|No such file or directory): *['\"]([^'\"\n]+)"
    r"|(/[^'\"\n:]+)['\"]?: (?:Permission denied|No such file or directory)"
)


def remedy(message: str, *, isolation: str | None) -> str:
    """Return what to append to a failure caused by a path that the harness can use and its policy cannot; otherwise
    empty.

    ``isolation``: the isolation of the policy's process, in the words of recordings.
    """
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
