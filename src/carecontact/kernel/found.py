"""Finds and checks the binary that this machine would load, and says which kernel it is. It loads neither the binary
nor MuJoCo.

A frozen protocol names a version of the person. Every later kernel must answer this version's contacts as the kernel
did with which the protocol was frozen. ``frozen.json`` holds the hashes of that kernel and, as ``equal_sources``, the
hash of the later sources that were shown to answer alike (``kernel.behaviour``; ``tools/frozen_kernel.py`` writes it).
To a protocol of this version, both are one kernel.
"""

from __future__ import annotations

import hashlib
import json
import sys
from importlib import metadata
from pathlib import Path

from carecontact.errors import DependencyError
from carecontact.kernel import binary


def sha256() -> str:
    """Return the sha256 (hex) of the binary, on which every result depends besides MuJoCo's version.

    Raises DependencyError as ``file`` does.
    """
    return hashlib.sha256(file().read_bytes()).hexdigest()


FROZEN = binary.FOLDER / "frozen.json"
"""Version of the person -> hashes of the sources and binaries of the kernel with which its protocols were frozen, and
of the later sources that answer alike."""


def identity(version: str) -> str:
    """Return the hash by which recordings name the kernel that simulated a version of the person.

    It is the sha256 (hex) of the installed binary, or that of the kernel with which the version's protocols were frozen
    if the installed one was shown to answer alike. Raises DependencyError as ``file`` does.
    """
    here = sha256()
    return frozen_binary(version) or here


def frozen_binary(version: str) -> str | None:
    """Return the hash of the binary with which a version's protocols were frozen, if the sources here answer alike."""
    frozen = json.loads(FROZEN.read_text(encoding="ascii")).get(version)
    if frozen is None or binary.sources_sha256() != frozen["equal_sources"]:
        return None
    return frozen["binaries"].get(binary.platform_here())


def sources_identity(version: str) -> str:
    """Return the hash of the C sources as locks hold it: that of the sources of the frozen kernel if these here were
    shown to answer alike."""
    frozen = json.loads(FROZEN.read_text(encoding="ascii")).get(version)
    here = binary.sources_sha256()
    return frozen["sources"] if frozen is not None and frozen["equal_sources"] == here else here


def file() -> Path:
    """Return the path of the binary. Raises DependencyError if ``problem`` finds one."""
    if found := problem():
        what, command = found
        raise DependencyError(f"the compiled tissue {what}" + (f"; run `{command}`" if command else ""))
    return binary.library_file(binary.platform_here())


def problem() -> tuple[str, str | None] | None:
    """Return why this machine cannot load the binary, or None if it can.

    The reason is the end of a sentence about the binary: it does not exist for the platform, it is missing, it does not
    belong to the C sources beside it, or MuJoCo has another version. The second item is the command that helps, or None
    if no command does.
    """
    name = binary.platform_here()
    if fault := binary.fault(name):
        return fault, making() if name in binary.PLATFORMS else None
    try:
        version = metadata.version("mujoco")
    except metadata.PackageNotFoundError:
        version = "not installed"
    if version != binary.MUJOCO:
        pip = f"{sys.executable} -m pip install mujoco=={binary.MUJOCO}"
        return f"needs MuJoCo {binary.MUJOCO}, and it is {version}", pip
    return None


def making(*, afresh: bool = False) -> str:
    """Return the command that makes or installs the right binary.

    Args:
        afresh: whether the command shall replace a binary that has the right mark but does not load.
    """
    clone = binary.FOLDER.parents[2]
    if (clone / "tools" / "bootstrap.sh").is_file():
        make = f"make -C {clone} env"
        return f"rm {binary.library_file(binary.platform_here())} && {make}" if afresh else make
    return f"{sys.executable} -m pip install --force-reinstall --no-deps CARECONTACT.whl"
