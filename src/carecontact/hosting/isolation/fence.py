"""Isolates the policy's process as far as this system can. It is called before anything else is imported there."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from carecontact.hosting.isolation.allowlist import rights
from carecontact.hosting.isolation.landlock import SCOPES_SINCE, restrict, version
from carecontact.hosting.isolation.system_calls import can_filter_calls, filter_calls
from carecontact.hosting.isolation.unlisted import UnlistedFolders
from carecontact.own_process import drop_capabilities

if TYPE_CHECKING:
    from carecontact.hosting.child import Options

TRUNCATE_SINCE = 3
CACHES = (
    "TRITON_HOME", "TRITON_CACHE_DIR", "CUPY_CACHE_DIR", "CUDA_CACHE_PATH", "MPLCONFIGDIR", "NUMBA_CACHE_DIR",
    "HF_TOKEN_PATH",
)  # fmt: skip
"""Variables that name folders in which libraries keep compiled files and, in the last one, look for a key of the user.
By default these lie in the home folder, and some libraries fail if they cannot use it."""
NAME_FILES = ("LD_LIBRARY_PATH", "SSL_CERT_FILE")


def level(kernel: int, *, calls: bool) -> str:
    """Describe the isolation that a version of Landlock gives; version 0 is a kernel without it.

    The first word of the description is the level: full, partial or none.

    ``calls``: whether system calls are filtered as well.
    """
    if kernel >= SCOPES_SINCE and calls:
        return "full"
    if kernel >= SCOPES_SINCE:
        return "partial: this system cannot filter system calls (seccomp)"
    if kernel >= TRUNCATE_SINCE:
        return "partial: this kernel's Landlock does not close signals to the harness and abstract sockets (Linux 6.12)"
    if kernel:
        return "partial: this kernel's Landlock closes neither emptying a file nor signals to the harness (Linux 6.12)"
    return "none: this system has no Landlock (Linux 5.13), or forbids it"


def available() -> str:
    """Return the description (``level``) of the isolation that this system can give a policy."""
    return level(version(), calls=can_filter_calls())


def isolate(options: Options) -> None:
    """Give up all rights that a policy does not need.

    Afterwards, ``options["isolation"]`` describes the level and what the user opened, in the words of recordings.
    """
    options["isolation"] = _enclose(options) if options["isolated"] else "none: switched off"


def _enclose(options: Options) -> str:
    search_path, record = options["search_path"], options["language"].get("record")
    if record is not None:
        # A single file can be opened to the policy only if it exists.
        with suppress(OSError):
            open(record, "ab").close()
    allowed = rights(
        search_path=search_path,
        target=options["target"],
        given=[*options["arguments"].values(), *options["language"].values(), *_variables(options["environment"])],
        record=record,
        readable=options["readable"],
        writable=options["writable"],
        closed=options["closed"],
    )
    # The policy can read these options, and the names of the folders tell where the run is stored.
    options["closed"] = []
    for name in CACHES:
        os.environ.setdefault(name, os.path.join(tempfile.gettempdir(), name.lower()))
    drop_capabilities()
    reached = level(restrict(allowed), calls=filter_calls())
    if unlisted := [folder for folder in (*search_path, *sys.path) if os.path.isdir(folder) and not _listed(folder)]:
        sys.meta_path.append(UnlistedFolders(unlisted))
    for word, paths in (("read", options["readable"]), ("write", options["writable"])):
        if paths:
            reached += f"; --policy-{word} {' '.join(paths)}"
    return reached


def _variables(names: Sequence[str]) -> list[str]:
    """Return the values of the variables that --policy-env let pass, and of the usual variables that name files."""
    return [os.environ[name] for name in (*names, *NAME_FILES) if name in os.environ]


def _listed(folder: str) -> bool:
    try:
        os.listdir(folder)
    except PermissionError:
        return False
    return True
