"""Isolates the policy's process as far as this system can, before anything else is imported there."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from carecontact.hosting.isolation.allowlist import Allowed, allowed, own_rights
from carecontact.hosting.isolation.landlock import SCOPES_SINCE, restrict, version
from carecontact.hosting.isolation.namespaces import granted
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


def level(kernel: int, *, namespaces: bool) -> str:
    """Describe the isolation that a version of Landlock gives, with or without namespaces; version 0 is a kernel
    without it.

    The first word of the description is the level: full, partial or none.
    """
    around = f"{'with' if namespaces else 'without'} namespaces"
    if not kernel:
        missing = "Landlock (Linux 5.13), or this system forbids it"
        return f"partial: namespaces without {missing}" if namespaces else f"none: neither namespaces nor {missing}"
    if kernel < TRUNCATE_SINCE:
        return f"partial: Landlock {around}, and emptying a file is open (Linux 6.2)"
    if namespaces:
        return "full: namespaces and Landlock"
    if kernel < SCOPES_SINCE:
        return f"partial: Landlock {around}, and signals to the harness are open (Linux 6.12)"
    return f"partial: Landlock {around}"


def available() -> str:
    """Return the description (``level``) of the isolation that this system can give a policy."""
    return level(version(), namespaces=granted())


def closes_signals() -> bool:
    """Whether an isolated policy has no means to send the harness a signal."""
    return granted() or version() >= SCOPES_SINCE


def prepare(options: Options) -> Allowed:
    """Find what the policy's process may use, before namespaces hide anything."""
    record = options["language"].get("record")
    if record is not None:
        # A single file can be opened to the policy only if it exists.
        with suppress(OSError):
            open(record, "ab").close()
    return allowed(
        search_path=options["search_path"],
        target=options["target"],
        given=[*options["arguments"].values(), *options["language"].values(), *_variables(options["environment"])],
        record=record,
        readable=options["readable"],
        writable=options["writable"],
        closed=options["closed"],
    )


def isolate(options: Options, allowed: Allowed | None) -> None:
    """Give up all rights that a policy does not need; none if ``allowed`` is None.

    Afterwards, ``options["isolation"]`` describes the level and what the user opened, in the words of recordings.
    """
    if allowed is None:
        options["isolation"] = "none: switched off"
        return
    for name in CACHES:
        os.environ.setdefault(name, os.path.join(tempfile.gettempdir(), name.lower()))
    drop_capabilities()
    kernel = restrict(allowed.rights | own_rights(options["closed"]))
    reached = level(kernel, namespaces=options["namespaces"])
    # The policy can read these options, and the names of the folders tell where the run is stored.
    options["closed"] = []
    folders = (*options["search_path"], *sys.path)
    if unlisted := [folder for folder in folders if os.path.isdir(folder) and not _listed(folder)]:
        sys.meta_path.append(UnlistedFolders(unlisted))
    for word, paths in (("read", options["readable"]), ("write", options["writable"])):
        if paths:
            reached += f"; --policy-{word} {' '.join(paths)}"
    options["isolation"] = reached


def _variables(names: Sequence[str]) -> list[str]:
    """Return the values of the variables that --policy-env let pass, and of the usual variables that name files."""
    return [os.environ[name] for name in (*names, *NAME_FILES) if name in os.environ]


def _listed(folder: str) -> bool:
    try:
        os.listdir(folder)
    except PermissionError:
        return False
    return True
